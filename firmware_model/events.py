"""Where the smooth motion ends: what counts as an event, and what the machine does at one.

Starts, stops and reversals by dry friction with true stick, the meeting and parting of two bodies with play between
them, an end of travel, and the end of a current through a diode. ``broken`` says whether a state lies beyond an
event; ``settle`` carries a state lying on one over to its next regime.
"""

from __future__ import annotations

import math

from firmware_model.circuit import sign
from firmware_model.compiled import part
from firmware_model.layout import (
    BODIES,
    CONTACT,
    LOAD_OMEGA,
    LOAD_SIDE,
    LOAD_THETA,
    OMEGA,
    SIDE,
    STOPPED,
    THETA,
    C,
)
from firmware_model.physics import (
    dry,
    electrical,
    holding,
    inertias,
    one_torque,
    two_torques,
)
from firmware_model.winding import current_broken, settle_flow

L, KT, HALF_GAP, STIFFNESS = int(C.L), int(C.KT), int(C.HALF_GAP), int(C.STIFFNESS)
FAST = int(C.FAST)
SMALL_A = 1e-12
LOAD_COULOMB, STOP = int(C.LOAD_COULOMB), int(C.STOP)


@part
def start(torque, forward, reverse, stopped, stop):  # type: ignore[no-untyped-def]
    """Direction in which a body at rest starts (0: held) against its break-away torques and an end of travel."""
    if torque > forward and not (stopped != 0 and stop > 0.0):
        return 1
    if torque < -reverse and not (stopped != 0 and stop < 0.0):
        return -1
    return 0


@part
def parting(time, y, m, duty, effort, p, on):  # type: ignore[no-untyped-def]
    """Accelerations that motor and load would have apart, and their directions of sliding; for bodies in contact."""
    motor, load = two_torques(time, y, m, duty, effort, p, on)
    motor_j, load_j = inertias(time, y, duty, p, on)
    if y[OMEGA] != 0.0:
        side = sign(y[OMEGA])
        load_side = side
    else:
        forward = holding(time, y, 1.0, effort, duty, p, on)
        reverse = holding(time, y, -1.0, effort, duty, p, on)
        side = start(motor, forward, reverse, 0, 0.0)
        load_side = start(load, p[LOAD_COULOMB], p[LOAD_COULOMB], m[STOPPED], p[STOP])
    motor_rate = 0.0
    load_rate = 0.0
    if side != 0:
        motor_rate = (motor - dry(time, y, float(side), effort, duty, p, on)) / motor_j
    if load_side != 0:
        load_rate = (load - load_side * p[LOAD_COULOMB]) / load_j
    return motor_rate, load_rate, side, load_side


@part
def broken(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Whether the state has gone beyond an event."""
    return current_broken(time, y, m, duty, p, on) or body_broken(time, y, m, duty, p, on)


@part
def body_broken(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Whether the bodies have gone beyond an event."""
    side = m[SIDE]
    if side != 0 and y[OMEGA] * side < 0.0:
        return True
    if m[BODIES] == 1:
        if side == 0:
            current, _ = electrical(time, y, m, duty, p, on)
            effort = p[KT] * current
            torque = one_torque(time, y, m, duty, effort, p, on)
            forward = holding(time, y, 1.0, effort, duty, p, on)
            reverse = holding(time, y, -1.0, effort, duty, p, on)
            return start(torque, forward, reverse, m[STOPPED], p[STOP]) != 0
        return m[STOPPED] == 0 and abs(p[STOP]) < math.inf and (y[THETA] - p[STOP]) * p[STOP] > 0.0
    if m[LOAD_SIDE] != 0 and y[LOAD_OMEGA] * m[LOAD_SIDE] < 0.0:
        return True
    if m[STOPPED] == 0 and abs(p[STOP]) < math.inf and (y[LOAD_THETA] - p[STOP]) * p[STOP] > 0.0:
        return True
    if m[CONTACT] == 0:
        if p[STIFFNESS] <= 0.0:
            twist = y[THETA] - y[LOAD_THETA]
            if abs(twist) > p[HALF_GAP] and (y[OMEGA] - y[LOAD_OMEGA]) * twist > 0.0:
                return True
        if side != 0 and m[LOAD_SIDE] != 0:
            return False
    current, _ = electrical(time, y, m, duty, p, on)
    effort = p[KT] * current
    if m[CONTACT] != 0:
        motor_rate, load_rate, _, _ = parting(time, y, m, duty, effort, p, on)
        if (motor_rate - load_rate) * m[CONTACT] < 0.0:
            return True
        if side != 0:
            return False
        motor, load = two_torques(time, y, m, duty, effort, p, on)
        forward = holding(time, y, 1.0, effort, duty, p, on) + p[LOAD_COULOMB]
        reverse = holding(time, y, -1.0, effort, duty, p, on) + p[LOAD_COULOMB]
        return start(motor + load, forward, reverse, m[STOPPED], p[STOP]) != 0
    motor, load = two_torques(time, y, m, duty, effort, p, on)
    if side == 0:
        forward = holding(time, y, 1.0, effort, duty, p, on)
        reverse = holding(time, y, -1.0, effort, duty, p, on)
        if start(motor, forward, reverse, 0, 0.0) != 0:
            return True
    return m[LOAD_SIDE] == 0 and start(load, p[LOAD_COULOMB], p[LOAD_COULOMB], m[STOPPED], p[STOP]) != 0


@part
def settle_stop(y, m, theta, omega, side, p):  # type: ignore[no-untyped-def]
    """Bring the body with the end of travel to rest on it, or let it go."""
    if abs(p[STOP]) == math.inf:
        return
    if (y[theta] - p[STOP]) * p[STOP] >= 0.0 and y[omega] * p[STOP] >= 0.0:
        if y[omega] != 0.0 or m[STOPPED] == 0:
            y[omega] = 0.0
            m[side] = 0
        y[theta] = p[STOP]
        m[STOPPED] = 1
    elif y[omega] * p[STOP] < 0.0:
        m[STOPPED] = 0


@part
def settle_one(time, y, m, duty, effort, p, on):  # type: ignore[no-untyped-def]
    settle_stop(y, m, THETA, OMEGA, SIDE, p)
    if y[OMEGA] * m[SIDE] < 0.0:
        y[OMEGA] = 0.0
    if y[OMEGA] != 0.0:
        m[SIDE] = sign(y[OMEGA])
        return
    torque = one_torque(time, y, m, duty, effort, p, on)
    forward = holding(time, y, 1.0, effort, duty, p, on)
    reverse = holding(time, y, -1.0, effort, duty, p, on)
    m[SIDE] = start(torque, forward, reverse, m[STOPPED], p[STOP])
    if m[SIDE] != 0:
        m[STOPPED] = 0


@part
def meet(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Rigid, inelastic meeting of motor and load where the gap is closed and still closing."""
    twist = y[THETA] - y[LOAD_THETA]
    if m[CONTACT] != 0 or abs(twist) < p[HALF_GAP] or (y[OMEGA] - y[LOAD_OMEGA]) * twist <= 0.0:
        return
    motor_j, load_j = inertias(time, y, duty, p, on)
    common = (motor_j * y[OMEGA] + load_j * y[LOAD_OMEGA]) / (motor_j + load_j)
    if m[STOPPED] != 0 and common * p[STOP] > 0.0:
        common = 0.0
    m[CONTACT] = sign(twist)
    y[OMEGA] = common
    y[LOAD_OMEGA] = common
    m[SIDE] = sign(common)
    m[LOAD_SIDE] = m[SIDE]


@part
def settle_two(time, y, m, duty, effort, p, on):  # type: ignore[no-untyped-def]
    settle_stop(y, m, LOAD_THETA, LOAD_OMEGA, LOAD_SIDE, p)
    if m[STOPPED] != 0 and m[CONTACT] != 0 and y[OMEGA] * p[STOP] > 0.0:
        # The load has run onto its end; a motor pushing it stops with it, one running ahead of it goes on.
        if m[CONTACT] * p[STOP] > 0.0:
            y[OMEGA] = 0.0
        else:
            m[CONTACT] = 0
    if y[OMEGA] * m[SIDE] < 0.0:
        y[OMEGA] = 0.0
        if m[CONTACT] != 0:
            y[LOAD_OMEGA] = 0.0
    if y[LOAD_OMEGA] * m[LOAD_SIDE] < 0.0:
        y[LOAD_OMEGA] = 0.0
        if m[CONTACT] != 0:
            y[OMEGA] = 0.0
    if p[STIFFNESS] <= 0.0:
        meet(time, y, m, duty, p, on)
    if m[CONTACT] != 0:
        y[LOAD_THETA] = y[THETA] - m[CONTACT] * p[HALF_GAP]
        y[LOAD_OMEGA] = y[OMEGA]
        motor_rate, load_rate, side, load_side = parting(time, y, m, duty, effort, p, on)
        if (motor_rate - load_rate) * m[CONTACT] >= 0.0:
            if y[OMEGA] == 0.0:
                motor, load = two_torques(time, y, m, duty, effort, p, on)
                forward = holding(time, y, 1.0, effort, duty, p, on) + p[LOAD_COULOMB]
                reverse = holding(time, y, -1.0, effort, duty, p, on) + p[LOAD_COULOMB]
                side = start(motor + load, forward, reverse, m[STOPPED], p[STOP])
            m[SIDE] = side
            m[LOAD_SIDE] = side
            return
        m[CONTACT] = 0
        m[SIDE] = side
        m[LOAD_SIDE] = load_side
        return
    motor, load = two_torques(time, y, m, duty, effort, p, on)
    if y[OMEGA] != 0.0:
        m[SIDE] = sign(y[OMEGA])
    else:
        forward = holding(time, y, 1.0, effort, duty, p, on)
        reverse = holding(time, y, -1.0, effort, duty, p, on)
        m[SIDE] = start(motor, forward, reverse, 0, 0.0)
    if y[LOAD_OMEGA] != 0.0:
        m[LOAD_SIDE] = sign(y[LOAD_OMEGA])
    else:
        m[LOAD_SIDE] = start(load, p[LOAD_COULOMB], p[LOAD_COULOMB], m[STOPPED], p[STOP])
    # A contact that is closed at rest and would stay so is a contact, not a series of meetings.
    if p[STIFFNESS] <= 0.0 and y[OMEGA] == y[LOAD_OMEGA]:
        twist = y[THETA] - y[LOAD_THETA]
        if abs(twist) >= p[HALF_GAP] * (1.0 - 1e-12):
            m[CONTACT] = sign(twist)
            motor_rate, load_rate, side, load_side = parting(time, y, m, duty, effort, p, on)
            if (motor_rate - load_rate) * m[CONTACT] <= 0.0:
                m[CONTACT] = 0
            else:
                m[SIDE] = sign(y[OMEGA])
                m[LOAD_SIDE] = m[SIDE]
                if y[OMEGA] == 0.0:
                    forward = holding(time, y, 1.0, effort, duty, p, on) + p[LOAD_COULOMB]
                    reverse = holding(time, y, -1.0, effort, duty, p, on) + p[LOAD_COULOMB]
                    m[SIDE] = start(motor + load, forward, reverse, m[STOPPED], p[STOP])
                    m[LOAD_SIDE] = m[SIDE]


@part
def settle(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Choose the regime from here on: who slides which way, who is held, who touches whom."""
    settle_flow(time, y, m, duty, p, on)
    current, _ = electrical(time, y, m, duty, p, on)
    effort = p[KT] * current
    if m[BODIES] == 1:
        settle_one(time, y, m, duty, effort, p, on)
    else:
        settle_two(time, y, m, duty, effort, p, on)
