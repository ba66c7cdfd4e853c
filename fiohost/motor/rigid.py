"""One rigid inertia: exact steps between events, true stick, no regularised sign. Part of the kernel."""

from __future__ import annotations

from fiohost.motor.compiled import inlined
from fiohost.motor.flow import (
    decay,
    deflect,
    flow,
    flow_by,
    hold_level,
    net_torque,
    plant,
    relax,
    settled_current,
    time_to_rest,
)
from fiohost.motor.hooks import torque
from fiohost.motor.state import (
    BREAKAWAY,
    BRISTLE,
    BRISTLE_ON,
    HALF_DECAY,
    HEATING_ON,
    LOAD_THETA,
    OMEGA,
    SMALLEST_BREAKAWAY,
    STANDBY,
    STEP_DECAY,
    STOP,
    STOP_ON,
    THETA,
)

MAX_EVENTS = 400


@inlined
def advance(state, duty, mode, time, span, substep, play, p, on):  # type: ignore[no-untyped-def]
    """Carry the shaft over a span of constant command; with play the load trails it through every event.

    Where torques depend on the state, steps are at most ``substep`` long and take the torque at the predicted
    midpoint; with ``substep`` 0 the whole span is one exact step. A step ends where the speed crosses zero; there the
    shaft rests while drive minus load stays within break-away.
    """
    bristle = on[BRISTLE_ON] and p[BREAKAWAY] >= SMALLEST_BREAKAWAY
    emf = mode != STANDBY
    theta, omega = state[THETA], state[OMEGA]
    left, push = span, 0.0
    for _ in range(MAX_EVENTS):
        if left <= 0.0:
            break
        gain, tau, grip = plant(time, p, on)
        dt = min(left, substep) if substep > 0.0 else left
        if omega == 0.0:
            push = settled_current(0.0, time, duty, mode, gain, state, p, on)
            drive = push + torque(theta, 0.0, time, duty, p, on)
            direction = 1.0 if drive > 0.0 else -1.0
            at_stop = on[STOP_ON] and theta == p[STOP] and drive * p[STOP] > 0.0
            if at_stop or (not bristle and abs(drive) <= hold_level(theta, time, push, direction, state, grip, p, on)):
                relax(state, 0.0, push, dt, p, on)
                left -= dt
                time += dt
                continue
        else:
            direction = 1.0 if omega > 0.0 else -1.0
        net = net_torque(theta, omega, time, duty, direction, mode, bristle, gain, grip, state, p, on)
        middle = omega
        if substep > 0.0:
            fallen = decay(state, HALF_DECAY, 0.5 * dt, tau) if emf else 0.0
            half, middle = flow_by(omega, net, emf, gain, tau, 0.5 * dt, fallen)
            if middle * direction < 0.0 and not (bristle and omega == 0.0):
                middle = 0.0
            was = state[BRISTLE]
            if bristle:
                deflect(state, half, p)
            at = time + 0.5 * dt
            net = net_torque(theta + half, middle, at, duty, direction, mode, bristle, gain, grip, state, p, on)
            state[BRISTLE] = was
        fallen = decay(state, STEP_DECAY, dt, tau) if emf else 0.0
        turn, after = flow_by(omega, net, emf, gain, tau, dt, fallen)
        if after * direction <= 0.0 and not (bristle and omega == 0.0):
            if omega == 0.0:
                relax(state, 0.0, push, dt, p, on)
                left -= dt
                time += dt
                continue
            dt = time_to_rest(omega, net, emf, gain, tau, dt)
            turn, _ = flow(omega, net, emf, gain, tau, dt)
            after = 0.0
        if on[STOP_ON]:
            beyond = theta + turn - p[STOP]
            if beyond * p[STOP] > 0.0 and (theta - p[STOP]) * p[STOP] <= 0.0:
                dt *= (p[STOP] - theta) / turn
                turn = p[STOP] - theta
                after = 0.0
        if bristle:
            deflect(state, turn, p)
        if on[HEATING_ON]:
            push = settled_current(middle, time, duty, mode, gain, state, p, on)
        relax(state, middle, push, dt, p, on)
        theta = p[STOP] if on[STOP_ON] and turn == p[STOP] - theta else theta + turn
        omega = after
        if play > 0.0:
            state[LOAD_THETA] = min(max(state[LOAD_THETA], theta - play), theta + play)
        left -= dt
        time += dt
    state[THETA] = theta
    state[OMEGA] = omega
