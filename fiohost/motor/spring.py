"""Motor and load joined by a spring with damping. Part of the kernel."""

from __future__ import annotations

from math import pi

from fiohost.motor.compiled import inlined
from fiohost.motor.flow import decay, flow, flow_by, hold_level, net_torque, plant, relax, settled_current, time_to_rest
from fiohost.motor.hooks import torque
from fiohost.motor.rigid import MAX_EVENTS
from fiohost.motor.state import (
    DAMPING,
    HALF_DECAY,
    HEATING_ON,
    LOAD_OMEGA,
    LOAD_THETA,
    OMEGA,
    RESONANCE,
    SPRING_SHARE,
    STANDBY,
    STEP_DECAY,
    THETA,
)


@inlined
def advance_spring(state, duty, mode, time, span, substep, p, on):  # type: ignore[no-untyped-def]
    """Carry motor and load: the spring's torque is taken at the predicted midpoint of each sub-step.

    The resonance is that of both inertias swinging against each other: ``k = J r (1 - r) (2 pi f)**2`` with ``r`` the
    load's share of the whole inertia ``J``. Friction and loads act on the motor's side.
    """
    share = p[SPRING_SHARE]
    pulse = 2.0 * pi * p[RESONANCE]
    emf = mode != STANDBY
    theta, omega, load_theta, load_omega = state[THETA], state[OMEGA], state[LOAD_THETA], state[LOAD_OMEGA]
    left, push = span, 0.0
    for _ in range(MAX_EVENTS):
        if left <= 0.0:
            break
        gain, tau, grip = plant(time, p, on)
        stiff = tau / gain * share * (1.0 - share) * pulse * pulse
        damp = tau / gain * share * (1.0 - share) * 2.0 * p[DAMPING] * pulse
        own, other = tau * (1.0 - share), tau * share
        dt = min(left, substep)
        twist = stiff * (theta - load_theta) + damp * (omega - load_omega)
        stuck = False
        if omega == 0.0:
            push = settled_current(0.0, time, duty, mode, gain, state, p, on)
            drive = push + torque(theta, 0.0, time, duty, p, on) - twist
            direction = 1.0 if drive > 0.0 else -1.0
            stuck = abs(drive) <= hold_level(theta, time, push, direction, state, grip, p, on)
        else:
            direction = 1.0 if omega > 0.0 else -1.0
        turn, after, half, middle = 0.0, 0.0, 0.0, 0.0
        if not stuck:
            net = net_torque(theta, omega, time, duty, direction, mode, False, gain, grip, state, p, on) - twist
            fallen = decay(state, HALF_DECAY, 0.5 * dt, own) if emf else 0.0
            half, middle = flow_by(omega, net, emf, gain, own, 0.5 * dt, fallen)
            if middle * direction < 0.0:
                middle = 0.0
        load_middle = load_omega + 0.5 * dt * gain * twist / other
        load_half = load_theta + 0.25 * dt * (load_omega + load_middle)
        twist = stiff * (theta + half - load_half) + damp * (middle - load_middle)
        if not stuck:
            net = net_torque(
                theta + half, middle, time + 0.5 * dt, duty, direction, mode, False, gain, grip, state, p, on
            )
            net -= twist
            fallen = decay(state, STEP_DECAY, dt, own) if emf else 0.0
            turn, after = flow_by(omega, net, emf, gain, own, dt, fallen)
            if after * direction <= 0.0:
                if omega == 0.0:
                    turn = 0.0
                else:
                    dt = time_to_rest(omega, net, emf, gain, own, dt)
                    turn, _ = flow(omega, net, emf, gain, own, dt)
                after = 0.0
        rate = gain * twist / other
        load_theta += (load_omega + 0.5 * rate * dt) * dt
        load_omega += rate * dt
        if on[HEATING_ON]:
            push = settled_current(middle, time, duty, mode, gain, state, p, on)
        relax(state, middle, push, dt, p, on)
        theta += turn
        omega = after
        left -= dt
        time += dt
    state[THETA], state[OMEGA], state[LOAD_THETA], state[LOAD_OMEGA] = theta, omega, load_theta, load_omega
