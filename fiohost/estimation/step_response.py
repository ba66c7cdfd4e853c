"""Step responses of a closed loop: their figures, and the second-order form that has the same overshoot and peak time.

This is the quick way by hand, done for every step of a square wave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiohost.control.metrics import StepFigures, step_figures
from fiohost.errors import DataError
from fiohost.estimation.second_order import from_overshoot

SHORTEST = 20


@dataclass(frozen=True)
class LoopStep:
    """One step of the reference and its response.

    Times count from the moment when the answer to the step begins to act. ``zeta`` and ``omega_n_rad_s`` are None where
    nothing overshoots, and where the duty was at its limit: then the response is no linear one.
    """

    at_s: float
    from_deg: float
    to_deg: float
    figures: StepFigures
    saturated: bool
    zeta: float | None = None
    omega_n_rad_s: float | None = None


def steps_of(
    time_s: np.ndarray, ref_deg: np.ndarray, y_deg: np.ndarray, duty_pct: np.ndarray, limit_pct: float, delay_s: float
) -> list[LoopStep]:
    """Every step of a reference with its response up to the next one, arrays (n) each.

    How a run gets to its first level is no step, unless there is no other. Pieces of fewer than SHORTEST samples are
    left out.
    """
    edges = [int(k) for k in np.flatnonzero(np.diff(ref_deg)) + 1] or [0]
    found = []
    for first, last in zip(edges, [*edges[1:], len(time_s)], strict=True):
        if last - first < SHORTEST:
            continue
        times, y = time_s[first:last] - time_s[first] - delay_s, y_deg[first:last]
        start, target = float(y[0]), float(ref_deg[first])
        if start == target:
            continue
        figures = step_figures(times, y, start, target)
        saturated = bool(np.max(np.abs(duty_pct[first:last])) >= limit_pct)
        step = LoopStep(float(time_s[first]), start, target, figures, saturated)
        found.append(step if saturated else _with_form(step, times, y))
    return found


def _with_form(step: LoopStep, times: np.ndarray, y: np.ndarray) -> LoopStep:
    way = (y - step.from_deg) / (step.figures.final - step.from_deg) if step.figures.final != step.from_deg else y * 0.0
    top = int(np.argmax(way))
    last = top + int(np.argmax(np.append(way[top:] < way[top], True))) - 1  # a count is flat at the peak: its middle
    peak_s = 0.5 * float(times[top] + times[last])
    try:
        zeta, omega_n = from_overshoot(step.figures.overshoot_pct, peak_s)
    except DataError:
        return step
    return LoopStep(step.at_s, step.from_deg, step.to_deg, step.figures, step.saturated, zeta, omega_n)
