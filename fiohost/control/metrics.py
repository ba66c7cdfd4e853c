"""Figures of a step response: overshoot, rise, peak and settling times, final value and steady-state error.

Crossings are found by straight lines between samples, so the figures are not bound to the sampling. All are bounded:
a response that does not get somewhere takes the whole run for it, and one that goes nowhere does not overshoot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiohost.errors import DataError
from fiohost.motor.compiled import compiled, inlined

TAIL = 0.1  # share of the run whose mean is the final value
STANDS_STILL = 1e-6  # a change of this share of what was asked for is none
ROUND_OFF_PCT = 1e-6  # no overshoot: so much a mean of equal readings differs from them, or a slow approach
MOST_OVERSHOOT_PCT = 1000.0
LEAST_CHANGE = 1e-150  # of less, shares overflow


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


def step_figures(
    time_s: np.ndarray, y: np.ndarray, start: float, target: float, times_of_target: bool = False
) -> StepFigures:
    """Figures of a response ``y`` (n) at times (n) from a step of the reference, from ``start`` to ``target``.

    Rise is from 10 to 90 % of the change, settling the last time outside a band around the final value (Golnaraghi and
    Kuo, Automatic Control Systems, section 7-3); with ``times_of_target`` both are of the way that was asked for, as
    lines on a plot that do not move with the response. Raises DataError for fewer than two samples or ones not finite.
    """
    if len(y) < 2 or len(time_s) != len(y):
        raise DataError("a step response needs two samples or more, each with its time")
    if not (np.isfinite(y).all() and np.isfinite(time_s).all()):
        raise DataError("a step response holds values that are not finite numbers")
    found = np.empty(6)
    _figures(
        np.ascontiguousarray(time_s, dtype=np.float64), np.ascontiguousarray(y, dtype=np.float64), start, target,
        times_of_target, found,
    )  # fmt: skip
    overshoot, rise, peak, settling_2, settling_5, final = (float(value) for value in found)
    return StepFigures(overshoot, rise, peak, settling_2, settling_5, final, target - final)


@inlined
def _first(time_s, y, start, change, level):  # type: ignore[no-untyped-def]
    """When the response first reaches a level of its change; the end of the run where it does not."""
    for k in range(y.shape[0]):
        way = (y[k] - start) / change
        if way >= level:
            if k == 0:
                return time_s[0]
            before = (y[k - 1] - start) / change
            return time_s[k - 1] + (level - before) / (way - before) * (time_s[k] - time_s[k - 1])
    return time_s[-1]


@inlined
def _settled(time_s, y, start, change, band):  # type: ignore[no-untyped-def]
    """When the response comes into the band about its final value for good; the end of the run where it does not."""
    n = y.shape[0]
    for k in range(n - 1, -1, -1):
        way = (y[k] - start) / change
        if abs(way - 1.0) > band:
            if k == n - 1:
                return time_s[n - 1]
            edge = 1.0 + band if way > 1.0 else 1.0 - band
            share = (edge - way) / ((y[k + 1] - start) / change - way)
            return time_s[k] + min(max(share, 0.0), 1.0) * (time_s[k + 1] - time_s[k])
    return time_s[0]


@compiled
def _figures(time_s, y, start, target, times_of_target, found):  # type: ignore[no-untyped-def]
    """Overshoot, rise, peak time, settling to 2 and 5 %, final value."""
    n = y.shape[0]
    tail = max(1, round(TAIL * n))
    final = 0.0
    for k in range(n - tail, n):
        final += y[k] / tail
    change = final - start
    last = time_s[n - 1]
    found[0], found[1], found[2], found[3], found[4], found[5] = 0.0, last, last, last, last, final
    way = target - start if times_of_target else change
    if abs(change) <= STANDS_STILL * abs(target - start) or min(abs(change), abs(way)) < LEAST_CHANGE:
        return
    peak = 0
    for k in range(n):
        if (y[k] - y[peak]) * change > 0.0:
            peak = k
    over = 100.0 * ((y[peak] - start) / change - 1.0)
    found[0] = min(over, MOST_OVERSHOOT_PCT) if over > ROUND_OFF_PCT else 0.0
    found[2] = time_s[peak]
    found[1] = _first(time_s, y, start, way, 0.9) - _first(time_s, y, start, way, 0.1)
    found[3] = _settled(time_s, y, start, way, 0.02)
    found[4] = _settled(time_s, y, start, way, 0.05)
