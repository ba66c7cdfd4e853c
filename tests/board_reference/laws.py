"""The equations, written from the effects' own words and compiled: rates of the state and margins to the next event.

``x`` is the state and ``c`` the record of ``constants``. A margin is positive while the regime holds.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from .constants import POINTS, PULSES, STATES

HAIR = 1e-13  # N m, rad/s2: a balance that is exact is no event
PLAY = 1e-12  # rad, beyond the gap: bodies that part with next to no force do not meet again by a rounding
law: Any = numba.njit(cache=True)


# -- winding


@law
def swing(t, c):
    q = c[0]
    return q.ripple * math.sin(2.0 * math.pi * q.ripple_hz * t + q.ripple_phase)


@law
def full_volts(t, x, c):
    """Voltage at full duty, positive."""
    q = c[0]
    volts = q.supply * max(1.0 + q.drift * t, 0.0) * q.gain * (1.0 + q.magnet * x[8])
    if q.ripples == 2.0:
        volts *= 1.0 + swing(t, c)
    return volts * q.reverse_gain if q.duty < 0.0 else volts


@law
def hot_ohms(x, c):
    q = c[0]
    return q.R * (1.0 + q.alpha * x[6]) + q.sag


@law
def push(t, x, c):
    """Voltage left for the winding's resistance and inductance, bridge losses apart."""
    q = c[0]
    return q.duty / 100.0 * full_volts(t, x, c) - q.Ke * x[1]


@law
def pulse(t, x, c):
    """Open between pulses, from zero current: time for the run-down less the time there is, in s; mean current along
    the duty; whether the pulse meets the limit.

    The peak follows from the rise through R and L, the run-down from the peak; the mean from the volt-seconds, because
    a current that begins and ends a period at zero leaves none in the inductance.
    """
    q = c[0]
    way = 1.0 if q.duty > 0.0 else -1.0
    part = abs(q.duty) / 100.0
    ohms = hot_ohms(x, c)
    emf = way * q.Ke * x[1]
    on = full_volts(t, x, c) - q.drop - emf
    off = full_volts(t, x, c) + q.drop + q.diode + emf
    if on <= 0.0:
        return -(1.0 - part) * q.period, 0.0, False
    if off <= 0.0:
        return 1.0, (part * on - (1.0 - part) * off) / ohms, False
    rise_s = part * q.period
    peak = on / ohms * (1.0 - math.exp(-rise_s * ohms / q.L))
    meets = peak > q.limit
    if meets:
        peak = q.limit
        rise_s = q.L / ohms * math.log(on / (on - ohms * q.limit))
    down_s = q.L / ohms * math.log((off + ohms * peak) / off)
    mean = (on * rise_s - off * down_s) / ohms / q.period
    if meets:
        mean += q.limit * (part - rise_s / q.period)
    return down_s - (1.0 - part) * q.period, mean, meets


@law
def current(t, x, c):
    q = c[0]
    if q.flow == PULSES:
        way = 1.0 if q.duty > 0.0 else -1.0
        return way * pulse(t, x, c)[1]
    if q.L > 0.0:
        return x[2]
    if q.standby:
        return 0.0
    volts = push(t, x, c)
    size = min(max(abs(volts) - q.drop, 0.0) / hot_ohms(x, c), q.limit)
    return size if volts > 0.0 else -size


@law
def outward(t, x, c):
    """Voltage across the inductance."""
    q = c[0]
    if q.standby:
        return -q.flow * q.supply - q.R * x[2] - q.Ke * x[1]
    if q.fast:
        part = abs(q.duty) / 100.0
        way = 1.0 if q.duty > 0.0 else -1.0
        full = full_volts(t, x, c)
        if q.flow * way < 0.0:
            volts = full + q.drop
        else:
            volts = part * (full - q.drop) - (1.0 - part) * (full + q.drop + q.diode)
        return way * volts - q.Ke * x[1] - hot_ohms(x, c) * x[2]
    return push(t, x, c) - q.flow * q.drop - hot_ohms(x, c) * x[2]


# -- torques


@law
def curve(angle, points):
    """Height at an angle: through four neighbours by their weights, which is Catmull and Rom's cubic."""
    place = (angle - points[0]) / points[1] * POINTS
    k = math.floor(place)
    u = place - k
    weights = (
        -u * (1.0 - u) ** 2 / 2.0,
        1.0 + u * u * (3.0 * u - 5.0) / 2.0,
        u * (1.0 + u * (4.0 - 3.0 * u)) / 2.0,
        -u * u * (1.0 - u) / 2.0,
    )
    height = 0.0
    for n in range(4):
        height += weights[n] * points[2 + (int(k) + n - 1) % POINTS]
    return height


@law
def level(t, x, side, c):
    """Dry friction on the motor towards ``side``, N m."""
    q = c[0]
    size = q.coulomb
    if side > 0.0:
        size += q.forward
    elif side < 0.0:
        size += q.reverse
    else:
        size += (q.forward + q.reverse) / 2.0
    size += q.stribeck * math.exp(-((x[1] / q.stribeck_speed) ** 2))
    size += q.tooth * abs(q.Kt * current(t, x, c))
    size += curve(x[0], q.friction_over_position)
    size *= 1.0 + q.turn * math.sin(q.turn_order * x[0] + q.turn_phase)
    return max(size * (1.0 - q.grease * x[7]) * q.friction, 0.0)


@law
def hold(t, x, side, c):
    """Torque that starts the motor from rest towards ``side``."""
    q = c[0]
    return 0.0 if q.bristle > 0.0 else level(t, x, side, c) + q.stiction


@law
def coupling(x, face, c):
    """Torque of the spring from motor to load, pressed at a face of the gap in it (0: no gap)."""
    q = c[0]
    return q.stiffness * (x[0] - x[3] - face * q.half) + q.damping * (x[1] - x[4])


@law
def passed(x, c):
    q = c[0]
    if q.stiffness == 0.0 or (q.half > 0.0 and q.pressed == 0.0):
        return 0.0
    return coupling(x, q.pressed, c)


@law
def motor_torque(t, x, c):
    """All torques on the motor but sliding friction; with one body, the loads too."""
    q = c[0]
    torque = q.Kt * current(t, x, c) - q.B * x[1] - q.drag * x[1] * abs(x[1])
    torque -= q.viscous * x[1] + (q.one_way * x[1] if x[1] * q.uphill > 0.0 else 0.0)
    torque -= q.thin * math.asinh(x[1] / q.knee)
    if q.ripples == 1.0:
        torque += q.Kt * q.supply / q.R * swing(t, c)
    torque -= q.cog * math.sin(q.cog_order * x[0] + q.cog_phase)
    if q.bristle > 0.0:
        torque -= level(t, x, np.sign(x[5]), c) * x[5] / q.bristle
    if q.load_J > 0.0:
        return torque - passed(x, c)
    return torque - q.load - q.weight * math.sin(x[0] + q.weight_phase) - curve(x[0], q.load_over_position)


@law
def load_torque(x, c):
    q = c[0]
    return passed(x, c) - q.load - q.weight * math.sin(x[3] + q.weight_phase) - curve(x[3], q.load_over_position)


@law
def slide(t, x, side, c):
    q = c[0]
    return 0.0 if q.bristle > 0.0 or side == 0.0 else side * level(t, x, side, c)


@law
def apart(t, x, side, c):
    """Accelerations of motor and load by themselves, the motor sliding towards ``side`` (0: held)."""
    q = c[0]
    load_j = q.load_J * q.inertia
    motor_j = q.J * q.inertia - load_j
    motor = 0.0
    if side != 0.0 or (q.bristle > 0.0 and not q.held):
        motor = (motor_torque(t, x, c) - slide(t, x, side, c)) / motor_j
    load = load_torque(x, c)
    if q.resting and load * q.stop >= 0.0:
        load = 0.0
    return motor, load / load_j


@law
def rates(t, x, c):
    q = c[0]
    d = np.zeros(STATES)
    if q.L > 0.0 and q.flow != 0.0 and q.flow != PULSES and q.limited == 0.0:
        d[2] = outward(t, x, c) / q.L
    if not q.held:
        d[0] = x[1]
        if q.load_J == 0.0:
            d[1] = (motor_torque(t, x, c) - slide(t, x, q.side, c)) / (q.J * q.inertia)
    if q.load_J > 0.0:
        if q.contact != 0.0:
            if not q.held:
                both = motor_torque(t, x, c) + load_torque(x, c) - slide(t, x, q.side, c)
                d[1] = both / (q.J * q.inertia)
            d[3], d[4] = d[0], d[1]
        else:
            motor, load = apart(t, x, q.side, c)
            d[1] = 0.0 if q.held else motor
            if not q.resting:
                d[3], d[4] = x[4], load
    if q.bristle > 0.0 and not q.held:
        way = q.side if q.side != 0.0 else np.sign(x[1])
        d[5] = x[1] * (1.0 - way * x[5] / q.bristle)
    i = current(t, x, c)
    d[6] = (i * i * q.R * (1.0 + q.alpha * x[6]) * q.thermal - x[6]) / q.thermal_tau
    if q.grease > 0.0:
        turning = 1.0 if q.side != 0.0 or d[0] != 0.0 else 0.0
        d[7] = (turning - x[7]) / q.grease_tau
    if q.magnet != 0.0:
        warm = 1.0
        if q.warms == 0.0:
            warm = 1.0 if q.side != 0.0 or d[0] != 0.0 else 0.0
        elif q.warms == 2.0:
            warm = (i * q.R / q.supply) ** 2
        d[8] = (warm - x[8]) / q.magnet_tau
    return d


# -- margins

TURN, START, LOAD_START, END, PULL, WALL_UP, WALL_DOWN, PRESS_UP, PRESS_DOWN = range(9)
CURRENT_END, CURRENT_START, LIMIT, UNLIMIT, UNBROKEN, RETURNED, CEASING = range(9, 16)
# Kinks: the equations go on in another form, no regime changes.
FIRST_KINK = 16
NO_CURRENT, LOSS, CLAMP, BRISTLE, LOAD_TURN = range(FIRST_KINK, FIRST_KINK + 5)
MARGINS = FIRST_KINK + 5


@law
def margin(which, t, x, c):
    """How far the state is from an event: positive while its regime holds, either sign for a kink."""
    q = c[0]
    way = 1.0 if q.stop > 0.0 else -1.0
    if which == TURN:
        return q.side * x[1]
    if which == START:
        torque = motor_torque(t, x, c) + (load_torque(x, c) if q.contact != 0.0 else 0.0)
        up, down = hold(t, x, 1.0, c) - torque, hold(t, x, -1.0, c) + torque
        if q.resting and (q.load_J == 0.0 or q.contact != 0.0):
            return (down if way > 0.0 else up) + HAIR
        return min(up, down) + HAIR
    if which == LOAD_START:
        return way * load_torque(x, c) + HAIR
    if which == END:
        return way * (q.stop - (x[3] if q.load_J > 0.0 else x[0]))
    if which == PULL:
        motor, load = apart(t, x, q.side, c)
        return (motor - load) * q.contact + HAIR
    if which in (WALL_UP, WALL_DOWN):
        face = 1.0 if which == WALL_UP else -1.0
        return q.half + PLAY - face * (x[0] - x[3])
    if which in (PRESS_UP, PRESS_DOWN):
        face = 1.0 if which == PRESS_UP else -1.0
        pressing = min(face * (x[0] - x[3]) - q.half, face * coupling(x, face, c))
        return pressing if q.pressed == face else -pressing
    if which == CURRENT_END:
        return q.flow * x[2]
    if which == CURRENT_START:
        return q.drop - abs(push(t, x, c))
    if which == LIMIT:
        return q.limit - abs(x[2])
    if which == UNLIMIT:
        return q.limited * outward(t, x, c)
    if which == UNBROKEN:  # the pulses still cease
        return -pulse(t, x, c)[0] * 1e4
    if which == RETURNED:  # the back-emf is not above the supply
        return full_volts(t, x, c) + q.drop - (q.Ke * x[1] if q.duty > 0.0 else -q.Ke * x[1])
    if which == CEASING:
        late, mean, meets = pulse(t, x, c)
        return max(late * 1e4, -1.0 if meets else (x[2] if q.duty > 0.0 else -x[2]) - mean)
    if which == NO_CURRENT:
        return current(t, x, c) if q.L > 0.0 else push(t, x, c)
    if which == LOSS:
        return abs(push(t, x, c)) - q.drop
    if which == CLAMP:
        return abs(push(t, x, c)) - q.drop - q.limit * hot_ohms(x, c)
    return x[5] if which == BRISTLE else x[4]
