"""Step responses of a closed loop: their figures, and the second-order form that has the same overshoot and peak time.

This is the quick way by hand, done for every step of a square wave.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fiohost.control.metrics import StepFigures, step_figures
from fiohost.errors import DataError
from fiohost.estimation.second_order import LEAST_OVERSHOOT_PCT, from_overshoot

SHORTEST = 20


@dataclass(frozen=True)
class LoopStep:
    """One step of the reference and its response.

    Times count from the moment when the answer to the step begins to act. The peak is the middle of its plateau, since
    a count is flat there; ``peak_half_s`` and ``overshoot_half_pct`` say how far plateau and half a count leave it
    open.
    ``zeta`` and ``omega_n_rad_s`` are None where nothing overshoots, and where the duty was at its limit: then the
    response is no linear one.
    """

    at_s: float
    from_deg: float
    to_deg: float
    figures: StepFigures
    saturated: bool
    zeta: float | None = None
    omega_n_rad_s: float | None = None
    overshoot_half_pct: float = 0.0
    peak_half_s: float = 0.0

    def corners(self) -> list[tuple[float, float]]:
        """zeta and wn at the ends of what counts leave open of overshoot and peak time; none without a form."""
        if self.zeta is None:
            return []
        f = self.figures
        return [
            from_overshoot(min(max(f.overshoot_pct + a * self.overshoot_half_pct, LEAST_OVERSHOOT_PCT), 99.9), peak)
            for a in (-1.0, 1.0)
            for b in (-1.0, 1.0)
            if (peak := f.peak_s + b * self.peak_half_s) > 0.0
        ]


def steps_of(
    time_s: np.ndarray, ref_deg: np.ndarray, y_deg: np.ndarray, duty_pct: np.ndarray, limit_pct: float, delay_s: float,
    count_deg: float = 0.0,
) -> list[LoopStep]:  # fmt: skip
    """Every step of a reference with its response up to the next one, arrays (n) each; ``count_deg`` is one count.

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
        if figures.final != start:
            step = _with_peak(step, times, y, count_deg)
        found.append(step if saturated else _with_form(step))
    return found


def _with_peak(step: LoopStep, times: np.ndarray, y: np.ndarray, count_deg: float) -> LoopStep:
    """The step with its peak in the middle of the plateau, and what is open about both."""
    way = (y - step.from_deg) / (step.figures.final - step.from_deg)
    top = int(np.argmax(way))
    last = top + int(np.argmax(np.append(way[top:] < way[top], True))) - 1
    tick_s = float(np.median(np.diff(times)))
    half_pct = 50.0 * count_deg / abs(step.figures.final - step.from_deg)
    return replace(
        step,
        figures=replace(step.figures, peak_s=0.5 * float(times[top] + times[last])),
        overshoot_half_pct=half_pct,
        peak_half_s=0.5 * (float(times[last] - times[top]) + tick_s),
    )


def _with_form(step: LoopStep) -> LoopStep:
    try:
        zeta, omega_n = from_overshoot(step.figures.overshoot_pct, step.figures.peak_s)
    except DataError:
        return step
    return replace(step, zeta=zeta, omega_n_rad_s=omega_n)
