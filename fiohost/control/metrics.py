"""Figures of a step response: overshoot, rise, peak and settling times, final value and steady-state error.

Crossings are found by straight lines between samples, so the figures are not bound to the sampling. All are bounded:
a response that does not get somewhere takes the whole run for it, and one that goes nowhere does not overshoot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiohost.errors import DataError

TAIL = 0.1  # share of the run whose mean is the final value
STANDS_STILL = 1e-6  # a change of this share of what was asked for is none
MOST_OVERSHOOT_PCT = 1000.0


@dataclass(frozen=True)
class StepFigures:
    """Times in seconds from the step, values in the response's unit.

    ``overshoot_pct`` and both settling times are of the response's own final value, as on a plot; the
    ``steady_state_error`` is what was asked for less the final value.
    """

    overshoot_pct: float
    rise_s: float
    peak_s: float
    settling_2_s: float
    settling_5_s: float
    final: float
    steady_state_error: float


def step_figures(time_s: np.ndarray, y: np.ndarray, start: float, target: float) -> StepFigures:
    """Figures of a response ``y`` (n) at times (n) from a step of the reference, from ``start`` to ``target``.

    Rise is from 10 to 90 % of the change, settling the last time outside a band around the final value (Golnaraghi and
    Kuo, Automatic Control Systems, section 7-3). Raises DataError for fewer than two samples or ones not finite.
    """
    if len(y) < 2 or len(time_s) != len(y):
        raise DataError("a step response needs two samples or more, each with its time")
    if not (np.isfinite(y).all() and np.isfinite(time_s).all()):
        raise DataError("a step response holds values that are not finite numbers")
    last = float(time_s[-1])
    final = float(y[-max(1, round(TAIL * len(y))) :].mean())
    change = final - start
    if abs(change) <= STANDS_STILL * max(abs(target - start), 1e-300):
        return StepFigures(0.0, last, last, last, last, final, target - final)
    way = (y - start) / change
    peak = int(np.argmax(way))
    return StepFigures(
        overshoot_pct=float(np.clip(100.0 * (way[peak] - 1.0), 0.0, MOST_OVERSHOOT_PCT)),
        rise_s=_first(time_s, way, 0.9) - _first(time_s, way, 0.1),
        peak_s=float(time_s[peak]),
        settling_2_s=_settled(time_s, way, 0.02),
        settling_5_s=_settled(time_s, way, 0.05),
        final=final,
        steady_state_error=target - final,
    )


def _first(time_s: np.ndarray, way: np.ndarray, level: float) -> float:
    """When the way first reaches a level; the end of the run where it does not."""
    k = int(np.argmax(way >= level))
    if way[k] < level:
        return float(time_s[-1])
    if k == 0:
        return float(time_s[0])
    return float(np.interp(level, way[k - 1 : k + 1], time_s[k - 1 : k + 1]))


def _settled(time_s: np.ndarray, way: np.ndarray, band: float) -> float:
    """When the way comes into the band about 1 for good; the end of the run where it does not."""
    outside = np.flatnonzero(np.abs(way - 1.0) > band)
    if not outside.size:
        return float(time_s[0])
    k = int(outside[-1])
    if k + 1 == len(way):
        return float(time_s[-1])
    edge = 1.0 + band if way[k] > 1.0 else 1.0 - band
    share = (edge - way[k]) / (way[k + 1] - way[k])
    return float(time_s[k] + min(max(share, 0.0), 1.0) * (time_s[k + 1] - time_s[k]))
