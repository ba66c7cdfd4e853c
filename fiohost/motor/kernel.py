"""The simulation kernel: exact exponential steps between events, true stick, no regularised sign.

Between events the drive is constant, so speed and angle follow closed forms: with ``ws = K f`` the speed that the net
torque ``f`` would reach, ``omega(t) = ws + (omega0 - ws) exp(-t/tau)``. Where a torque depends on the state, the step
is cut to ``substep_s`` and the torque is taken at the midpoint. A step ends where the speed crosses zero; there the
shaft rests while drive minus load stays within break-away. Without state-dependent torques a whole hold is one exact
step.

Units: degrees (or the unit of a linear axis), seconds, percent of duty.
"""

from __future__ import annotations

from math import expm1, log1p

import numpy as np

from fiohost.motor.compiled import compiled, inlined
from fiohost.motor.effect import layout
from fiohost.motor.hooks import EFFECT_INDEX, breakaway, command, friction, torque

# State of the shaft: the motor's angle and speed, the load's beyond a gap, the side in contact (-1, 0 in the gap, +1).
THETA, OMEGA, LOAD_THETA, LOAD_OMEGA, CONTACT = range(5)
STATE_SIZE = 5

GAIN = layout()["linear"]
TAU = GAIN + 1
BACKLASH = EFFECT_INDEX["backlash"]
GAP = layout()["backlash"]
SIDE = GAP + 1
SHARE = GAP + 2
DELAY_ON = EFFECT_INDEX["transport_delay"]
DELAY = layout()["transport_delay"]

MAX_EVENTS = 200
SMALLEST_SHARE = 0.01
DRIVE = 1
STANDBY = 0


@inlined
def _net(theta, omega, time, duty, direction, p, on):  # type: ignore[no-untyped-def]
    """Drive minus loads minus sliding friction, in percent, without the back-emf."""
    drive = duty + torque(theta, omega, time, duty, p, on)
    return drive - direction * max(friction(theta, omega, time, drive, direction, p, on), 0.0)


@inlined
def _flow(omega, net, driven, gain, tau, dt):  # type: ignore[no-untyped-def]
    """Angle and speed after dt under a constant net torque; standby has no back-emf, so no exponential."""
    if driven:
        steady = gain * net
        decay = expm1(-dt / tau)
        change = (omega - steady) * decay
        return steady * dt - tau * change, omega + change
    rate = gain * net / tau
    return (omega + 0.5 * rate * dt) * dt, omega + rate * dt


@inlined
def _time_to_rest(omega, net, driven, gain, tau, dt):  # type: ignore[no-untyped-def]
    """When the speed reaches zero under a constant net torque, given that it does within dt."""
    at = -tau * log1p(-omega / (omega - gain * net)) if driven else -omega * tau / (gain * net)
    return min(max(at, 0.0), dt)


@inlined
def _net_over(theta, omega, time, duty, direction, driven, gain, tau, dt, substeps, p, on):  # type: ignore[no-untyped-def]
    """The net torque of a step: where it depends on the state, its value at the predicted midpoint."""
    net = _net(theta, omega, time, duty, direction, p, on)
    if not substeps:
        return net
    turn, middle = _flow(omega, net, driven, gain, tau, 0.5 * dt)
    if middle * direction < 0.0:
        middle = 0.0
    return _net(theta + turn, middle, time + 0.5 * dt, duty, direction, p, on)


@inlined
def _advance(state, duty, mode, time, span, substep, play, p, on):  # type: ignore[no-untyped-def]
    """Carry one rigid inertia over a span of constant command; with play the load trails it through every event."""
    gain, tau = p[GAIN], p[TAU]
    driven = mode != STANDBY
    substeps = substep > 0.0
    theta, omega = state[THETA], state[OMEGA]
    left = span
    for _ in range(MAX_EVENTS):
        if left <= 0.0:
            break
        dt = min(left, substep) if substeps else left
        if omega == 0.0:
            drive = duty + torque(theta, 0.0, time, duty, p, on)
            direction = 1.0 if drive > 0.0 else -1.0
            hold = max(friction(theta, 0.0, time, drive, direction, p, on), 0.0) + breakaway(p, on)
            if abs(drive) <= hold:
                left -= dt
                time += dt
                continue
        else:
            direction = 1.0 if omega > 0.0 else -1.0
        net = _net_over(theta, omega, time, duty, direction, driven, gain, tau, dt, substeps, p, on)
        turn, after = _flow(omega, net, driven, gain, tau, dt)
        if after * direction <= 0.0:
            if omega == 0.0:
                left -= dt
                time += dt
                continue
            dt = _time_to_rest(omega, net, driven, gain, tau, dt)
            turn, after = _flow(omega, net, driven, gain, tau, dt)
            after = 0.0
        theta += turn
        omega = after
        if play > 0.0:
            state[LOAD_THETA] = min(max(state[LOAD_THETA], theta - play), theta + play)
        left -= dt
        time += dt
    state[THETA] = theta
    state[OMEGA] = omega


@inlined
def _time_to_wall(slack, omega, load_omega, net, driven, gain, tau, dt):  # type: ignore[no-untyped-def]
    """When a motor free in the gap has closed ``slack`` on a load of constant speed, or -1 if not within dt.

    The relative motion has at most one turning point, so the first passage lies before it or the step has none
    before the second half; both halves are monotone and are searched by bisection, safe at any parameters.
    """
    sign = 1.0 if slack > 0.0 else -1.0
    size = abs(slack)
    turn = dt
    relative = (omega - load_omega) * sign
    _, after = _flow(omega, net, driven, gain, tau, dt)
    if relative * (after - load_omega) * sign < 0.0:
        low, high = 0.0, dt
        for _ in range(40):
            middle = 0.5 * (low + high)
            _, speed = _flow(omega, net, driven, gain, tau, middle)
            if (speed - load_omega) * sign * relative > 0.0:
                low = middle
            else:
                high = middle
        turn = 0.5 * (low + high)
    start = 0.0
    for end in (turn, dt):
        moved, _ = _flow(omega, net, driven, gain, tau, end)
        if (moved - load_omega * end) * sign >= size:
            low, high = start, end
            for _ in range(48):
                middle = 0.5 * (low + high)
                moved, _ = _flow(omega, net, driven, gain, tau, middle)
                if (moved - load_omega * middle) * sign >= size:
                    high = middle
                else:
                    low = middle
            return high
        start = end
    return -1.0


@inlined
def _advance_gap(state, duty, mode, time, span, substep, p, on):  # type: ignore[no-untyped-def]
    """Carry a motor and a load with a gap between them: rigid together in contact, an inelastic impact to join.

    All friction and loads act on the motor's side; the load runs free in the gap. They part when the load would
    have to be pulled, that is when the common acceleration points away from the side in contact.
    """
    gain, tau = p[GAIN], p[TAU]
    share = p[SHARE]
    half = 0.5 * p[GAP]
    driven = mode != STANDBY
    theta, omega = state[THETA], state[OMEGA]
    load_theta, load_omega, contact = state[LOAD_THETA], state[LOAD_OMEGA], state[CONTACT]
    left = span
    for _ in range(MAX_EVENTS):
        if left <= 0.0:
            break
        dt = min(left, substep) if substep > 0.0 else left
        direction = 0.0
        if omega != 0.0:
            direction = 1.0 if omega > 0.0 else -1.0
        else:
            drive = duty + torque(theta, 0.0, time, duty, p, on)
            side = 1.0 if drive > 0.0 else -1.0
            hold = max(friction(theta, 0.0, time, drive, side, p, on), 0.0) + breakaway(p, on)
            if abs(drive) > hold:
                direction = side
        net = 0.0
        if direction != 0.0:
            net = _net_over(theta, omega, time, duty, direction, driven, gain, tau, dt, substep > 0.0, p, on)
        if contact != 0.0:
            pull = gain * net - (omega if driven else 0.0)
            if direction == 0.0 and omega == 0.0:
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
            turn, after = _flow(omega, net, driven, gain, rate, dt)
            if after * direction <= 0.0:
                if omega == 0.0:
                    turn, after = 0.0, 0.0
                    direction = 0.0
                else:
                    dt = _time_to_rest(omega, net, driven, gain, rate, dt)
                    turn, _ = _flow(omega, net, driven, gain, rate, dt)
                    after = 0.0
        if contact == 0.0:
            play = theta - load_theta
            hit = -1.0
            wall = 0.0
            for candidate in (half, -half):
                slack = candidate - play
                closing = candidate > 0.0
                if abs(slack) < 1e-12:
                    outward = (omega - load_omega) * candidate
                    if outward < 0.0 or (
                        outward == 0.0 and (gain * net - (omega if driven else 0.0)) * candidate <= 0.0
                    ):
                        continue
                    slack = 1e-12 if closing else -1e-12
                if direction == 0.0:
                    at = slack / -load_omega if load_omega != 0.0 else -1.0
                    if at > dt:
                        at = -1.0
                else:
                    at = _time_to_wall(slack, omega, load_omega, net, driven, gain, rate, dt)
                if at >= 0.0 and (hit < 0.0 or at < hit):
                    hit = at
                    wall = 1.0 if closing else -1.0
            if hit >= 0.0:
                dt = hit
                turn, after = (0.0, 0.0) if direction == 0.0 else _flow(omega, net, driven, gain, rate, dt)
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
        left -= dt
        time += dt
    state[THETA] = theta
    state[OMEGA] = omega
    state[LOAD_THETA] = load_theta
    state[LOAD_OMEGA] = load_omega
    state[CONTACT] = contact


@compiled
def simulate(times, act_times, duties, modes, first, last, state, substep, p, on, states):  # type: ignore[no-untyped-def]
    """Simulate samples ``first..last`` of a record from ``state``; ``states[k - first]`` is the state at ``times[k]``.

    ``duties[0]`` and ``modes[0]`` are what acted before the first row's command; ``act_times[j]`` is when
    ``duties[j+1]`` begins to act, before any transport delay of the model. ``substep`` 0 takes each hold in one exact
    step.
    """
    delay = p[DELAY] if on[DELAY_ON] else 0.0
    gap = on[BACKLASH] and p[GAP] > 0.0
    two = gap and p[SHARE] >= SMALLEST_SHARE
    play = 0.5 * p[GAP] if gap else 0.0
    now = times[first]
    j = np.searchsorted(act_times, now - delay, side="right")
    duty = command(duties[j], p, on)
    for i in range(STATE_SIZE):
        states[0, i] = state[i]
    n = act_times.shape[0]
    for k in range(first + 1, last):
        while now < times[k]:
            until = times[k]
            changes = j < n and act_times[j] + delay < until
            if changes:
                until = max(act_times[j] + delay, now)
            if until > now:
                if two:
                    _advance_gap(state, duty, modes[j], now, until - now, substep, p, on)
                else:
                    _advance(state, duty, modes[j], now, until - now, substep, play, p, on)
            now = until
            if changes:
                j += 1
                duty = command(duties[j], p, on)
        for i in range(STATE_SIZE):
            states[k - first, i] = state[i]
