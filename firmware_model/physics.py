"""The laws of the machine: currents, torques and the rates of the state between two events.

Within one step the directions of sliding and the closed face of the gap are held (they are switches, not functions of
the speed), so that the rates are smooth and a step may look beyond an event before it is cut there.
"""

from __future__ import annotations

import math

from firmware_model.circuit import DRIVEN, STANDBY, phase_electrical
from firmware_model.compiled import part
from firmware_model.hooks import (
    breakaway,
    ceiling,
    drop,
    friction,
    inertia,
    load_torque,
    motor_torque,
    own_rates,
    resistance,
    voltage,
)
from firmware_model.layout import (
    BODIES,
    CONTACT,
    CURRENT,
    FLOW,
    LOAD_OMEGA,
    LOAD_SIDE,
    LOAD_THETA,
    MEAN,
    MODE,
    OMEGA,
    OWN,
    PHASE,
    SIDE,
    SLIP,
    STATES,
    THETA,
    C,
)

R, L, KT, KE, J, B = int(C.R), int(C.L), int(C.KT), int(C.KE), int(C.J), int(C.B)
COULOMB, SUPPLY, EXTERNAL = int(C.COULOMB), int(C.SUPPLY), int(C.EXTERNAL)
LOAD_J, LOAD_COULOMB, HALF_GAP = int(C.LOAD_J), int(C.LOAD_COULOMB), int(C.HALF_GAP)
STIFFNESS, DAMPING, DEFLECTION = int(C.STIFFNESS), int(C.DAMPING), int(C.DEFLECTION)
FAST, DIODE, PERIOD = int(C.FAST), int(C.DIODE), int(C.PERIOD)
CEASING = 2


@part
def pulse(duty, on, off, ohms, henry, period, most):  # type: ignore[no-untyped-def]
    """Mean current of a winding that gets ``on`` volts for a duty 0..1 of each period and then loses ``off`` volts, its
    current never above ``most``.

    Returns the periodic mean in A and whether the current ceases within the period (discontinuous conduction).
    """
    if on <= 0.0:
        return 0.0, True
    if off <= 0.0:
        return min((duty * on - (1.0 - duty) * off) / ohms, most), False
    tau = henry / ohms
    pulse_s = duty * period
    up, down = on / ohms, off / ohms
    peak, charge = -up * math.expm1(-pulse_s / tau), 0.0
    if peak > most:
        risen_s = -tau * math.log1p(-most / up)
        peak, charge, pulse_s = most, most * (pulse_s - risen_s), risen_s
    fall_s = tau * math.log1p(peak / down)
    if fall_s >= (1.0 - duty) * period:
        return min((duty * on - (1.0 - duty) * off) / ohms, most), False
    charge += up * pulse_s - tau * peak - down * fall_s + tau * peak
    return charge / period, True


@part
def fast_circuit(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Fast decay, in the duty's direction: supply and back-emf in V, ohm, loss in V, greatest current in A."""
    theta, omega = y[THETA], y[OMEGA]
    way = 1.0 if duty > 0.0 else -1.0
    supply = way * voltage(way * p[SUPPLY], theta, omega, 0.0, 0.0, duty, time, y, p, on)
    ohms = resistance(p[R], theta, omega, 0.0, 0.0, duty, time, y, p, on)
    lost = drop(0.0, theta, omega, 0.0, 0.0, duty, time, y, p, on)
    most = ceiling(math.inf, theta, omega, 0.0, 0.0, duty, time, y, p, on)
    return way, supply, way * p[KE] * omega, ohms, lost, most


@part
def pulses(duty, p, supply, emf, ohms, lost, most):  # type: ignore[no-untyped-def]
    """Fast decay, in the duty's direction: mean current in A if each pulse begins from none, and whether it ceases."""
    up, down = supply - lost - emf, supply + lost + p[DIODE] + emf
    return pulse(0.01 * abs(duty), up, down, ohms, p[L], p[PERIOD], most)


@part
def is_clipped(duty, p, supply, emf, ohms, lost, most):  # type: ignore[no-untyped-def]
    """Fast decay, in the duty's direction: whether a pulse alone brings the current to its limit."""
    up = (supply - lost - emf) / ohms
    return up > most and -up * math.expm1(-0.01 * abs(duty) * p[PERIOD] * ohms / p[L]) > most


@part
def fast_electrical(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Current and its rate with the bridge open between the pulses."""
    way, supply, emf, ohms, lost, most = fast_circuit(time, y, m, duty, p, on)
    if m[FLOW] == CEASING:
        mean, _ = pulses(duty, p, supply, emf, ohms, lost, most)
        return way * mean, 0.0
    current = min(max(way * y[CURRENT], -most), most)
    if m[FLOW] * way < 0.0:
        # Against the duty the current meets the supply all the time, through the transistors or the diodes.
        rate = supply + lost - emf - ohms * current
    else:
        share = 0.01 * abs(duty)
        rate = share * (supply - lost) - (1.0 - share) * (supply + lost + p[DIODE]) - emf - ohms * current
    if (current >= most and rate > 0.0) or (current <= -most and rate < 0.0):
        rate = 0.0
    return way * current, way * rate / p[L]


@part
def pressure(time, y, duty, p, on):  # type: ignore[no-untyped-def]
    """Voltage that drives the current: the bridge's mean voltage less the back-emf."""
    omega = y[OMEGA]
    volts = voltage(0.01 * duty * p[SUPPLY], y[THETA], omega, 0.0, 0.0, duty, time, y, p, on)
    return volts - p[KE] * omega


@part
def electrical(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Current in A and its rate in A/s. Without inductance the current follows at once and has no rate."""
    if m[PHASE] != MEAN:
        return phase_electrical(time, y, m, duty, p, on)
    theta, omega = y[THETA], y[OMEGA]
    if m[MODE] == STANDBY:
        if p[L] <= 0.0 or m[FLOW] == 0:
            return 0.0, 0.0
        # The bridge is open: what still flows goes through its diodes into the supply.
        back = p[KE] * omega + p[R] * y[CURRENT] + m[FLOW] * p[SUPPLY]
        return y[CURRENT], -back / p[L]
    if p[FAST] > 0.0 and m[MODE] == DRIVEN:
        return fast_electrical(time, y, m, duty, p, on)
    push = pressure(time, y, duty, p, on)
    ohms = resistance(p[R], theta, omega, 0.0, 0.0, duty, time, y, p, on)
    lost = drop(0.0, theta, omega, 0.0, 0.0, duty, time, y, p, on)
    most = ceiling(math.inf, theta, omega, 0.0, 0.0, duty, time, y, p, on)
    if p[L] <= 0.0:
        if lost > 0.0:
            push = math.copysign(max(abs(push) - lost, 0.0), push)
        return min(max(push / ohms, -most), most), 0.0
    if m[FLOW] == 0:
        return 0.0, 0.0
    current = min(max(y[CURRENT], -most), most)
    rate = (push - m[FLOW] * lost - ohms * current) / p[L]
    if (current >= most and rate > 0.0) or (current <= -most and rate < 0.0):
        rate = 0.0
    return current, rate


@part
def loads(time, y, theta, omega, duty, p, on):  # type: ignore[no-untyped-def]
    """Torque of weights, hands and the like on the output shaft, N m."""
    return p[EXTERNAL] + load_torque(0.0, theta, omega, 0.0, 0.0, duty, time, y, p, on)


@part
def shaft(time, y, duty, effort, p, on):  # type: ignore[no-untyped-def]
    """Torque on the motor's body without dry friction and without loads, N m."""
    own = motor_torque(0.0, y[THETA], y[OMEGA], effort, 0.0, duty, time, y, p, on)
    return effort - p[B] * y[OMEGA] + own


@part
def sliding(time, y, side, effort, duty, p, on):  # type: ignore[no-untyped-def]
    """Size of the motor's sliding friction towards ``side``, N m."""
    return max(friction(p[COULOMB], y[THETA], y[OMEGA], effort, side, duty, time, y, p, on), 0.0)


@part
def holding(time, y, side, effort, duty, p, on):  # type: ignore[no-untyped-def]
    """Torque up to which the motor's friction holds it against a start towards ``side``, N m."""
    if p[DEFLECTION] > 0.0:
        return 0.0
    level = sliding(time, y, side, effort, duty, p, on)
    return breakaway(level, y[THETA], 0.0, effort, side, duty, time, y, p, on)


@part
def dry(time, y, side, effort, duty, p, on):  # type: ignore[no-untyped-def]
    """Sliding friction against a motion towards ``side``, N m, signed; none where a presliding spring stands for it."""
    if side == 0.0 or p[DEFLECTION] > 0.0:
        return 0.0
    return side * sliding(time, y, side, effort, duty, p, on)


@part
def bristle(time, y, effort, duty, p, on):  # type: ignore[no-untyped-def]
    """Friction of a presliding spring, N m, signed; where its size differs by direction, the deflection's counts."""
    side = 1.0 if y[SLIP] > 0.0 else (-1.0 if y[SLIP] < 0.0 else 0.0)
    return sliding(time, y, side, effort, duty, p, on) * y[SLIP] / p[DEFLECTION]


@part
def inertias(time, y, duty, p, on):  # type: ignore[no-untyped-def]
    """Inertia of the motor's body and of the load's, kg m2."""
    whole = inertia(p[J], y[THETA], y[OMEGA], 0.0, 0.0, duty, time, y, p, on)
    load = p[LOAD_J] * (whole / p[J])
    return whole - load, load


@part
def spring(y, p):  # type: ignore[no-untyped-def]
    """Torque of a springy coupling, from motor to load, N m; with play in it, it only pushes."""
    twist = y[THETA] - y[LOAD_THETA]
    half = p[HALF_GAP]
    if abs(twist) <= half and half > 0.0:
        return 0.0
    side = 1.0 if twist > 0.0 else -1.0
    torque = p[STIFFNESS] * (twist - side * half) + p[DAMPING] * (y[OMEGA] - y[LOAD_OMEGA])
    if half > 0.0 and torque * side < 0.0:
        return 0.0
    return torque


@part
def two_torques(time, y, m, duty, effort, p, on):  # type: ignore[no-untyped-def]
    """Torques on motor and load of a two-inertia machine, dry friction apart, N m."""
    motor = shaft(time, y, duty, effort, p, on)
    load = loads(time, y, y[LOAD_THETA], y[LOAD_OMEGA], duty, p, on)
    if p[STIFFNESS] > 0.0:
        passed = spring(y, p)
        motor -= passed
        load += passed
    if p[DEFLECTION] > 0.0:
        motor -= bristle(time, y, effort, duty, p, on)
    return motor, load


@part
def one_torque(time, y, m, duty, effort, p, on):  # type: ignore[no-untyped-def]
    """Torque on a machine of one inertia, dry friction apart, N m."""
    torque = shaft(time, y, duty, effort, p, on) + loads(time, y, y[THETA], y[OMEGA], duty, p, on)
    if p[DEFLECTION] > 0.0:
        torque -= bristle(time, y, effort, duty, p, on)
    return torque


@part
def rates(time, y, dy, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Rates of the whole state, into ``dy``."""
    current, change = electrical(time, y, m, duty, p, on)
    dy[CURRENT] = change
    mechanical(time, y, dy, m, duty, p[KT] * current, p, on)


@part
def mechanical(time, y, dy, m, duty, effort, p, on):  # type: ignore[no-untyped-def]
    """Rates of all but the current, into ``dy``, for a motor torque ``effort``."""
    side = float(m[SIDE])
    motor_j, load_j = inertias(time, y, duty, p, on)
    opposed = dry(time, y, side, effort, duty, p, on)
    if m[BODIES] == 1:
        dy[THETA] = 0.0
        dy[OMEGA] = 0.0
        dy[LOAD_THETA] = 0.0
        dy[LOAD_OMEGA] = 0.0
        if side != 0.0:
            dy[THETA] = y[OMEGA]
            dy[OMEGA] = (one_torque(time, y, m, duty, effort, p, on) - opposed) / motor_j
    else:
        motor, load = two_torques(time, y, m, duty, effort, p, on)
        load_side = float(m[LOAD_SIDE])
        motor -= opposed
        load -= load_side * p[LOAD_COULOMB]
        if m[CONTACT] != 0:
            motor = (motor + load) / (motor_j + load_j)
            load = motor
        else:
            motor /= motor_j
            load /= load_j
        moving = side != 0.0
        load_moving = load_side != 0.0
        dy[THETA] = y[OMEGA] if moving else 0.0
        dy[OMEGA] = motor if moving else 0.0
        dy[LOAD_THETA] = y[LOAD_OMEGA] if load_moving else 0.0
        dy[LOAD_OMEGA] = load if load_moving else 0.0
    if m[STATES] > SLIP:
        dy[SLIP] = 0.0
        if p[DEFLECTION] > 0.0:
            dy[SLIP] = y[OMEGA] * (1.0 - side * y[SLIP] / p[DEFLECTION])
        if m[STATES] > OWN:
            own_rates(y[THETA], y[OMEGA], effort, side, duty, time, y, dy, p, on)
