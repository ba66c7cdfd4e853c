"""Motor and load with play between them: rigid together in contact, apart in the gap. Part of the kernel."""

from __future__ import annotations

from fiohost.motor.compiled import inlined
from fiohost.motor.flow import decay, flow, flow_by, hold_level, net_torque, plant, relax, settled_current, time_to_rest
from fiohost.motor.hooks import torque
from fiohost.motor.rigid import MAX_EVENTS
from fiohost.motor.state import (
    CONTACT,
    GAP,
    HALF_DECAY,
    HEATING_ON,
    LOAD_OMEGA,
    LOAD_THETA,
    OMEGA,
    SHARE,
    STANDBY,
    STEP_DECAY,
    THETA,
)


@inlined
def time_to_wall(slack, omega, load_omega, net, emf, gain, tau, dt):  # type: ignore[no-untyped-def]
    """When a motor free in the gap has closed ``slack`` on a load of constant speed, or -1 if not within dt.

    The relative motion has at most one turning point, so the first passage lies before it or the step has none
    before the second half; both halves are monotone and are searched by bisection, safe at any parameters.
    """
    sign = 1.0 if slack > 0.0 else -1.0
    size = abs(slack)
    turn = dt
    relative = (omega - load_omega) * sign
    _, after = flow(omega, net, emf, gain, tau, dt)
    if relative * (after - load_omega) * sign < 0.0:
        low, high = 0.0, dt
        for _ in range(40):
            middle = 0.5 * (low + high)
            _, speed = flow(omega, net, emf, gain, tau, middle)
            if (speed - load_omega) * sign * relative > 0.0:
                low = middle
            else:
                high = middle
        turn = 0.5 * (low + high)
    start = 0.0
    for end in (turn, dt):
        moved, _ = flow(omega, net, emf, gain, tau, end)
        if (moved - load_omega * end) * sign >= size:
            low, high = start, end
            for _ in range(48):
                middle = 0.5 * (low + high)
                moved, _ = flow(omega, net, emf, gain, tau, middle)
                if (moved - load_omega * middle) * sign >= size:
                    high = middle
                else:
                    low = middle
            return high
        start = end
    return -1.0


@inlined
def advance_gap(state, duty, mode, time, span, substep, p, on):  # type: ignore[no-untyped-def]
    """Carry a motor and a load with a gap between them: rigid together in contact, an inelastic impact to join.

    All friction and loads act on the motor's side; the load runs free in the gap. They part when the load would
    have to be pulled, that is when the common acceleration points away from the side in contact.
    """
    share = p[SHARE]
    half = 0.5 * p[GAP]
    emf = mode != STANDBY
    theta, omega = state[THETA], state[OMEGA]
    load_theta, load_omega, contact = state[LOAD_THETA], state[LOAD_OMEGA], state[CONTACT]
    left, push = span, 0.0
    for _ in range(MAX_EVENTS):
        if left <= 0.0:
            break
        gain, tau, grip = plant(time, p, on)
        dt = min(left, substep) if substep > 0.0 else left
        direction = 0.0
        if omega != 0.0:
            direction = 1.0 if omega > 0.0 else -1.0
        else:
            push = settled_current(0.0, time, duty, mode, gain, state, p, on)
            drive = push + torque(theta, 0.0, time, duty, p, on)
            side = 1.0 if drive > 0.0 else -1.0
            if abs(drive) > hold_level(theta, time, push, side, state, grip, p, on):
                direction = side
        net = 0.0
        if direction != 0.0:
            net = net_torque(theta, omega, time, duty, direction, mode, False, gain, grip, state, p, on)
            if substep > 0.0:
                rate = tau if contact != 0.0 else tau * (1.0 - share)
                fallen = decay(state, HALF_DECAY, 0.5 * dt, rate) if emf else 0.0
                half, middle = flow_by(omega, net, emf, gain, rate, 0.5 * dt, fallen)
                if middle * direction < 0.0:
                    middle = 0.0
                at = time + 0.5 * dt
                net = net_torque(theta + half, middle, at, duty, direction, mode, False, gain, grip, state, p, on)
        if contact != 0.0:
            pull = gain * net - (omega if emf else 0.0)
            if direction == 0.0 and omega == 0.0:
                relax(state, 0.0, push, dt, p, on)
                left -= dt
                time += dt
                continue
            if pull * contact < 0.0:
                contact = 0.0
                load_omega = omega
                load_theta = theta - half * (1.0 if pull < 0.0 else -1.0)
        rate = tau if contact != 0.0 else tau * (1.0 - share)
        if direction == 0.0:
            turn, after = 0.0, 0.0
        else:
            fallen = decay(state, STEP_DECAY, dt, rate) if emf else 0.0
            turn, after = flow_by(omega, net, emf, gain, rate, dt, fallen)
            if after * direction <= 0.0:
                if omega == 0.0:
                    turn, after = 0.0, 0.0
                    direction = 0.0
                else:
                    dt = time_to_rest(omega, net, emf, gain, rate, dt)
                    turn, _ = flow(omega, net, emf, gain, rate, dt)
                    after = 0.0
        if contact == 0.0:
            play = theta - load_theta
            touching = 1e-12 + 1e-15 * abs(theta)  # as close as far angles can be told apart
            hit = -1.0
            wall = 0.0
            for candidate in (half, -half):
                slack = candidate - play
                closing = candidate > 0.0
                if abs(slack) < touching:
                    outward = (omega - load_omega) * candidate
                    if outward < 0.0 or (outward == 0.0 and (gain * net - (omega if emf else 0.0)) * candidate <= 0.0):
                        continue
                    slack = touching if closing else -touching
                if direction == 0.0:
                    at = slack / -load_omega if load_omega != 0.0 else -1.0
                    if at > dt:
                        at = -1.0
                else:
                    at = time_to_wall(slack, omega, load_omega, net, emf, gain, rate, dt)
                if at >= 0.0 and (hit < 0.0 or at < hit):
                    hit = at
                    wall = 1.0 if closing else -1.0
            if hit >= 0.0:
                dt = hit
                turn, after = (0.0, 0.0) if direction == 0.0 else flow(omega, net, emf, gain, rate, dt)
            load_theta += load_omega * dt
            theta += turn
            omega = after
            if hit >= 0.0:
                contact = wall
                omega = (1.0 - share) * omega + share * load_omega
                load_omega = omega
                load_theta = theta - half * wall
        else:
            theta += turn
            omega = after
            load_theta = theta - half * contact
            load_omega = omega
        if on[HEATING_ON]:
            push = settled_current(omega, time, duty, mode, gain, state, p, on)
        relax(state, omega, push, dt, p, on)
        left -= dt
        time += dt
    state[THETA] = theta
    state[OMEGA] = omega
    state[LOAD_THETA] = load_theta
    state[LOAD_OMEGA] = load_omega
    state[CONTACT] = contact
