"""The text's block diagram of a motor (Figs. D-24 to D-26, D-58) under a law, as good as continuous.

    L di/dt = v - R i - Kb w,    J dw/dt = Ki sat(i) - B w + T,    dtheta/dt = w

in SI units. A law answers at ticks; what it answers holds for a tick, so it is given the angle that will be in the
middle of that tick, and what is left of the ticks is of second order: figures agree with a continuous solution to four
digits.
"""

from __future__ import annotations

import math

import numpy as np

from fiohost.labs.constants import MotorConstants
from fiohost.labs.play import IDEAL, NO_LIMITS, Law, Limits, Run, SpeedLaw, Torque, play_model

SHORTEST_WINDING_S = 1e-4  # a shorter lag is none: the current follows at once
HALF_TICK, WHOLE_TICK = 0.5, 1.0


def play_ideal(
    q: MotorConstants, law: Law, duration_s: float, *, limits: Limits = NO_LIMITS, torque: Torque | None = None
) -> Run:
    """Play a law on the ideal motor, from rest. With dry friction among the constants, the fit's model is played."""
    if q.coulomb_Nm > 0.0:
        return play_model(q, law, duration_s, IDEAL, limits=limits, torque=torque)
    h = IDEAL.sample_time_s
    n = max(round(duration_s / h), 1) + 1
    # a speed is the difference of two angles, so half a tick older than an angle
    ahead = (WHOLE_TICK if isinstance(law, SpeedLaw) else HALF_TICK) * h
    top_V = math.inf if limits.volts is None else limits.volts
    top_A = math.inf if limits.amperes is None else limits.amperes
    times = np.arange(n) * h
    table = np.empty((n, 5))  # ref, angle, speed, volts, current
    scale = q.pct_per_volt
    i = w = theta = 0.0
    for k in range(n):
        wanted, ref = law.step(k, math.degrees(theta + ahead * w))
        volts = min(max(wanted / scale, -top_V), top_V)
        law.applied(volts * scale)
        load = 0.0 if torque is None else torque.at(float(times[k]))
        table[k] = ref, theta, w, volts, _current(q, i, w, volts, top_A)
        i, w, theta = _tick(q, i, w, theta, volts, load, top_A, h)
    refs, angles, speeds, given, currents = table.T
    return Run(IDEAL.name, times, refs, np.degrees(angles), speeds, given, currents)


def _current(q: MotorConstants, i: float, w: float, volts: float, top_A: float) -> float:
    """What the torque is made of: the winding's current, or Ohm's where it has no lag, within the limit."""
    if q.winding_s < SHORTEST_WINDING_S:
        i = (volts - q.Ke_Vs_per_rad * w) / q.R_ohm
    return min(max(i, -top_A), top_A)


def _tick(
    q: MotorConstants, i: float, w: float, theta: float, volts: float, load: float, top_A: float, h: float
) -> tuple[float, float, float]:
    """The state a tick later, by Runge and Kutta's fourth order."""
    lags = q.winding_s >= SHORTEST_WINDING_S

    def rates(i: float, w: float) -> tuple[float, float]:
        drive = q.Kt_Nm_per_A * _current(q, i, w, volts, top_A)
        slope = (volts - q.R_ohm * i - q.Ke_Vs_per_rad * w) / q.L_H if lags else 0.0
        return slope, (drive - q.B_Nms * w + load) / q.J_kgm2

    i1, w1 = rates(i, w)
    i2, w2 = rates(i + 0.5 * h * i1, w + 0.5 * h * w1)
    i3, w3 = rates(i + 0.5 * h * i2, w + 0.5 * h * w2)
    i4, w4 = rates(i + h * i3, w + h * w3)
    turned = h * w + h * h / 6.0 * (w1 + w2 + w3)
    return (
        i + h / 6.0 * (i1 + 2.0 * i2 + 2.0 * i3 + i4), w + h / 6.0 * (w1 + 2.0 * w2 + 2.0 * w3 + w4), theta + turned
    )  # fmt: skip
