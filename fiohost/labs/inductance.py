"""The winding's inductance: from a meter, from the decay with a known resistor (section D-1-3), or from how the current
rises after a step of voltage from rest.

A bench's own meter reads once a tick, which is longer than the winding's lag, so only the first readings after a step
know of it. By then the shaft hardly moves; how much it does is computed with the other constants and taken into
account.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from fiohost.labs.readings import Readings

LARGEST_H, LEAST_H = 10.0, 1e-7
STEPS = 400  # of the computed rise


def risen_A(
    L_H: float, volts: float, time_s: float, R: float, Ki: float, Kb: float, J: float, B: float, Tc: float
) -> float:
    """Current so long after a step of voltage from rest, dry friction holding the shaft until it is overcome."""
    h = time_s / STEPS
    decay = float(np.exp(-R / L_H * h))
    i = w = 0.0
    side = 1.0 if volts >= 0.0 else -1.0
    for _ in range(STEPS):
        goal = (volts - Kb * w) / R
        i = goal + (i - goal) * decay
        torque = Ki * i * side - Tc - B * abs(w)
        w += h * side * max(torque, 0.0) / J if w == 0.0 else h * side * torque / J
    return i


def inductance_H(
    readings: Readings, R: float, Ki: float, Kb: float, J: float, B: float, Tc: float
) -> tuple[float, str, int] | None:
    """Inductance, how it was found, and from how many readings; None where no reading tells it."""
    if readings.inductance_H:
        return float(np.mean(readings.inductance_H)), "by a meter", len(readings.inductance_H)
    if readings.decay:
        found = [time_s * (R + ohm) for ohm, time_s in readings.decay]
        return float(np.mean(found)), "La = tau_e (R + Ra) of the stalled winding", len(found)
    if not readings.rise:
        return None

    def misses(log_L: np.ndarray) -> list[float]:
        L = float(np.exp(log_L[0]))
        return [
            risen_A(L, volts, time_s, R, Ki, Kb, J, max(B, 0.0), max(Tc, 0.0)) - amps
            for volts, time_s, amps in readings.rise
        ]

    begin = np.log([rough_H(readings.rise, R)])
    best = least_squares(misses, begin, bounds=(np.log(LEAST_H), np.log(LARGEST_H)))
    return float(np.exp(best.x[0])), "from the current's rise after a step", len(readings.rise)


def rough_H(rise: Sequence[tuple[float, float, float]], R: float) -> float:
    """The inductance from the first reading of each rise as if the shaft were held."""
    first = min(time_s for _, time_s, _ in rise)
    shares = [np.clip(amps * R / volts, 0.02, 0.999) for volts, time_s, amps in rise if time_s == first]
    return float(np.clip(np.mean([-first * R / np.log(1.0 - share) for share in shares]), 10 * LEAST_H, LARGEST_H / 10))
