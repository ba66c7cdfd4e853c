"""One rigid inertia behind a winding with a lag of its own: current and speed as one exact second-order step.

With ``i`` the current in percent of stall, ``L`` the torque of loads and friction and ``d`` the duty that the
electrics let through, ``tau omega' = K (i + L)`` and ``lag i' = d - omega/K - i``. Around the steady point
``omega = K (d + L)``, ``i = -L`` the deviations follow a 2x2 matrix exponential, in closed form for real and for
complex poles. Part of the kernel.
"""

from __future__ import annotations

from math import cos, exp, log, sin, sqrt

from fiohost.motor.compiled import inlined
from fiohost.motor.flow import SAME_TIME_S, ceases, deflect, hold_level, plant, relax, resistance, settled_current
from fiohost.motor.hooks import torque
from fiohost.motor.rigid import MAX_EVENTS, advance
from fiohost.motor.state import (
    BREAKAWAY,
    BRISTLE,
    BRISTLE_ON,
    CURRENT,
    DRIVE,
    FAST_LAG,
    FAST_ON,
    HALF_SWING,
    LAG,
    LAG_ON,
    LOAD_THETA,
    OMEGA,
    SMALLEST_BREAKAWAY,
    STANDBY,
    STEP_SWING,
    STOP,
    STOP_ON,
    THETA,
)

HALVINGS = 48


@inlined
def swing(dt, tau, lag):  # type: ignore[no-untyped-def]
    """exp(a dt) cosh(b dt) and exp(a dt) sinh(b dt) / b for the poles a +- b of current and speed."""
    a = -0.5 / lag
    square = a * a - 1.0 / (tau * lag)
    if square > 1e-6 * a * a:
        b = sqrt(square)
        fast, slow = exp((a - b) * dt), exp((a + b) * dt)
        return 0.5 * (slow + fast), 0.5 * (slow - fast) / b
    fallen = exp(a * dt)
    if square < -1e-6 * a * a:
        b = sqrt(-square)
        return fallen * cos(b * dt), fallen * sin(b * dt) / b
    return fallen, fallen * dt


@inlined
def remembered(state, slot, dt, tau, lag):  # type: ignore[no-untyped-def]
    """``swing``, remembered in a slot of five numbers: most steps are as long as the one before."""
    if abs(dt - state[slot]) > SAME_TIME_S or tau != state[slot + 1] or lag != state[slot + 2]:
        state[slot], state[slot + 1], state[slot + 2] = dt, tau, lag
        state[slot + 3], state[slot + 4] = swing(dt, tau, lag)
    return state[slot + 3], state[slot + 4]


@inlined
def step(omega, amps, duty, load, gain, tau, lag, dt, c, s):  # type: ignore[no-untyped-def]
    """Angle turned, speed and current after dt; ``c`` and ``s`` are those of ``swing`` for that time."""
    steady = gain * (duty + load)
    w, v = (omega - steady) / gain, amps + load
    half = 0.5 / lag
    w1 = (c + half * s) * w + s / tau * v
    v1 = (c - half * s) * v - s / lag * w
    return steady * dt - gain * (lag * (v1 - v) + tau * (w1 - w)), steady + gain * w1, v1 - load


@inlined
def advance_lagged(state, duty, mode, time, span, substep, play, p, on):  # type: ignore[no-untyped-def]
    """Carry the shaft over a span of constant command; as ``rigid.advance``, with the current as a state.

    With the bridge open the current dies at once. Where it ceases within each pulse it follows its mean at once, but
    for what still flows of more before.
    """
    pulsed = on[FAST_ON] and mode == DRIVE
    if pulsed:
        gain, _, _ = plant(time, p, on)
        drive, falls_s = left_over(state[CURRENT], state[OMEGA], time, duty, gain, state, p, on)
        if falls_s > 0.0:
            falls_s = min(falls_s, span)
            carry(state, duty, mode, time, falls_s, substep, play, True, drive, p, on)
            time += falls_s
            span -= falls_s
            if span <= 0.0:
                return
    gain, _, _ = plant(time, p, on)
    if mode == STANDBY or (pulsed and (duty == 0.0 or ceases(state[OMEGA], duty, gain, p))):
        advance(state, duty, mode, time, span, substep, play, p, on)
        state[CURRENT] = settled_current(state[OMEGA], time + span, duty, mode, gain, state, p, on)
        return
    carry(state, duty, mode, time, span, substep, play, False, 0.0, p, on)


@inlined
def left_over(amps, omega, time, duty, gain, state, p, on):  # type: ignore[no-untyped-def]
    """Of a bridge open between its pulses, the drive in percent under which a current falls that is more than the duty
    makes, and how long it does.

    Against the duty the current meets the whole supply, in pulse and pause; along it the mean of both, until it is what
    ceases within each pulse.
    """
    share = min(abs(duty) * 0.01, 1.0)
    way = 1.0 if duty > 0.0 or (duty == 0.0 and amps < 0.0) else -1.0
    until = 0.0
    if amps * way <= 0.0 or duty == 0.0:
        drive = 100.0 * way
    else:
        if not ceases(omega, duty, gain, p):
            return 0.0, 0.0
        drive = 100.0 * way * (2.0 * share - 1.0)
        until = settled_current(omega, time, duty, DRIVE, gain, state, p, on)
    target = drive - omega / gain
    if (until - amps) * (target - until) <= 0.0 or amps == 0.0:
        return 0.0, 0.0
    return drive, (p[LAG] if on[LAG_ON] else p[FAST_LAG]) * log((amps - target) / (until - target))


@inlined
def carry(state, duty, mode, time, span, substep, play, forced, drive, p, on):  # type: ignore[no-untyped-def]
    """Carry the shaft over a span with the current as a state, which follows what the electrics let through of the
    duty, or, ``forced``, a given drive in percent. A shaft at rest is released when the rising current lets it go.
    """
    lag = p[LAG] if on[LAG_ON] else p[FAST_LAG]
    bristle = on[BRISTLE_ON] and p[BREAKAWAY] >= SMALLEST_BREAKAWAY
    theta, omega, amps = state[THETA], state[OMEGA], state[CURRENT]
    left = span
    for _ in range(MAX_EVENTS):
        if left <= 0.0:
            break
        gain, tau, grip = plant(time, p, on)
        dt = min(left, substep) if substep > 0.0 else left
        target = drive if forced else settled_current(omega, time, duty, mode, gain, state, p, on) + omega / gain
        direction = 1.0 if omega > 0.0 else -1.0
        if omega == 0.0:
            load = torque(theta, 0.0, time, duty, p, on)
            direction = 1.0 if amps + load > 0.0 else -1.0
            hold = hold_level(theta, time, amps, direction, state, grip, p, on)
            at_stop = on[STOP_ON] and theta == p[STOP] and (amps + load) * p[STOP] > 0.0
            if at_stop or (not bristle and abs(amps + load) <= hold):
                rest = dt
                if not at_stop and abs(target + load) > hold and amps != target:
                    edge = hold - load if target + load > 0.0 else -hold - load
                    rest = min(max(-lag * log((edge - target) / (amps - target)), 0.0), dt)
                    amps = target + (amps - target) * exp(-rest / lag)
                    if rest < dt:  # just beyond the edge, so that it slides now
                        amps = edge + 1e-9 * (target - edge)
                else:
                    amps = target + (amps - target) * exp(-rest / lag)
                relax(state, 0.0, amps, rest, p, on)
                left -= rest
                time += rest
                continue
        load = resistance(theta, omega, time, duty, amps, direction, bristle, grip, state, p, on)
        middle = omega
        if substep > 0.0:
            c, s = remembered(state, HALF_SWING, 0.5 * dt, tau, lag)
            half, middle, between = step(omega, amps, target, load, gain, tau, lag, 0.5 * dt, c, s)
            if middle * direction < 0.0 and not (bristle and omega == 0.0):
                middle = 0.0
            was = state[BRISTLE]
            at = time + 0.5 * dt
            if bristle:
                deflect(state, half, p)
            if not forced:
                target = settled_current(middle, at, duty, mode, gain, state, p, on) + middle / gain
            load = resistance(theta + half, middle, at, duty, between, direction, bristle, grip, state, p, on)
            state[BRISTLE] = was
        c, s = remembered(state, STEP_SWING, dt, tau, lag)
        turn, after, flowing = step(omega, amps, target, load, gain, tau, lag, dt, c, s)
        if after * direction <= 0.0 and not (bristle and omega == 0.0):
            if omega == 0.0:
                turn, after = 0.0, 0.0
                flowing = target + (amps - target) * exp(-dt / lag)
            else:
                low, high = 0.0, dt
                for _ in range(HALVINGS):
                    between = 0.5 * (low + high)
                    c, s = swing(between, tau, lag)
                    _, speed, _ = step(omega, amps, target, load, gain, tau, lag, between, c, s)
                    if speed * direction > 0.0:
                        low = between
                    else:
                        high = between
                dt = high
                c, s = swing(dt, tau, lag)
                turn, _, flowing = step(omega, amps, target, load, gain, tau, lag, dt, c, s)
                after = 0.0
        if on[STOP_ON]:
            beyond = theta + turn - p[STOP]
            if beyond * p[STOP] > 0.0 and (theta - p[STOP]) * p[STOP] <= 0.0:
                dt *= (p[STOP] - theta) / turn
                turn = p[STOP] - theta
                after = 0.0
        if bristle:
            deflect(state, turn, p)
        relax(state, middle, 0.5 * (amps + flowing), dt, p, on)
        theta = p[STOP] if on[STOP_ON] and turn == p[STOP] - theta else theta + turn
        omega, amps = after, flowing
        if play > 0.0:
            state[LOAD_THETA] = min(max(state[LOAD_THETA], theta - play), theta + play)
        left -= dt
        time += dt
    state[THETA] = theta
    state[OMEGA] = omega
    state[CURRENT] = amps
