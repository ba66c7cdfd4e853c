"""Closed forms between events, and what the torques are at one moment. Parts of the kernel.

With ``ws = K f`` the speed that a constant net torque ``f`` would reach, ``omega(t) = ws + (omega0 - ws) exp(-t/tau)``.
Without back-emf (standby) the speed grows in a straight line.
"""

from __future__ import annotations

from math import exp, expm1, log1p

from fiohost.motor.compiled import inlined
from fiohost.motor.effects.fast_decay import PERIOD_S, fall_time
from fiohost.motor.hooks import breakaway, current, friction, torque
from fiohost.motor.state import (
    BEARING,
    BREAKAWAY,
    BRISTLE,
    CHANGE_ON,
    CHANGE_RATIO,
    CHANGE_TIME,
    CHANGE_WHICH,
    DRIVE,
    FAST_LAG,
    FAST_ON,
    GAIN,
    HEATING,
    HEATING_ON,
    RISE,
    STANDBY,
    TAU,
    WARMING,
    WARMING_BY,
    WARMING_ON,
    WINDING,
)

SAME_TIME_S = 1e-12


@inlined
def decay(state, slot, dt, tau):  # type: ignore[no-untyped-def]
    """expm1(-dt / tau), remembered in a slot; times on a grid differ in their last digits, which is no difference."""
    if abs(dt - state[slot]) > SAME_TIME_S or tau != state[slot + 1]:
        state[slot], state[slot + 1], state[slot + 2] = dt, tau, expm1(-dt / tau)
    return state[slot + 2]


@inlined
def flow_by(omega, net, emf, gain, tau, dt, fallen):  # type: ignore[no-untyped-def]
    """Angle turned and speed after dt under a constant net torque, with ``fallen = expm1(-dt / tau)``; ``emf`` says
    that the back-emf is not in the torque.
    """
    if emf:
        steady = gain * net
        change = (omega - steady) * fallen
        return steady * dt - tau * change, omega + change
    rate = gain * net / tau
    return (omega + 0.5 * rate * dt) * dt, omega + rate * dt


@inlined
def flow(omega, net, emf, gain, tau, dt):  # type: ignore[no-untyped-def]
    """``flow_by`` for a span that is no usual one."""
    return flow_by(omega, net, emf, gain, tau, dt, expm1(-dt / tau) if emf else 0.0)


@inlined
def time_to_rest(omega, net, emf, gain, tau, dt):  # type: ignore[no-untyped-def]
    """When the speed reaches zero under a constant net torque, given that it does within dt."""
    at = -tau * log1p(-omega / (omega - gain * net)) if emf else -omega * tau / (gain * net)
    return min(max(at, 0.0), dt)


@inlined
def plant(time, p, on):  # type: ignore[no-untyped-def]
    """Gain, lag and a factor on friction at this time: they may change once during a run."""
    gain, tau, grip = p[GAIN], p[TAU], 1.0
    if on[CHANGE_ON] and time >= p[CHANGE_TIME]:
        if p[CHANGE_WHICH] == 0.0:
            tau *= p[CHANGE_RATIO]
        elif p[CHANGE_WHICH] == 1.0:
            grip = p[CHANGE_RATIO]
        elif p[CHANGE_WHICH] == 2.0:
            gain *= p[CHANGE_RATIO]
    return gain, tau, grip


@inlined
def settled_current(omega, time, duty, mode, gain, state, p, on):  # type: ignore[no-untyped-def]
    """The current in percent of stall once its own lag is over: duty minus back-emf, as the electrics let it
    through.
    """
    if mode == STANDBY or (mode == DRIVE and duty == 0.0 and on[FAST_ON]):
        return 0.0  # no pulse at all leaves a bridge open that is open between pulses; a brake shorts it
    emf = omega / gain
    return current(duty - emf, duty, emf, time, state[WINDING], p, on)


@inlined
def ceases(omega, duty, gain, p):  # type: ignore[no-untyped-def]
    """Whether the current of a bridge open between the pulses ceases within each of them (discontinuous conduction)."""
    on = min(abs(duty) * 0.01, 1.0)
    e = min(max(omega / gain * 0.01 * (1.0 if duty > 0.0 else -1.0), -0.99), 0.99)
    return on + fall_time(on, e, p[FAST_LAG] / PERIOD_S) < 1.0


@inlined
def grip_level(theta, omega, time, drive, direction, state, grip, p, on):  # type: ignore[no-untyped-def]
    """Sliding friction in percent, never negative."""
    return grip * max(friction(0.0, theta, omega, time, drive, direction, state[BEARING], p, on), 0.0)


@inlined
def hold_level(theta, time, drive, direction, state, grip, p, on):  # type: ignore[no-untyped-def]
    """Friction of a shaft at rest, in percent."""
    return grip_level(theta, 0.0, time, drive, direction, state, grip, p, on) + breakaway(p, on)


@inlined
def resistance(theta, omega, time, duty, drive, direction, bristle, grip, state, p, on):  # type: ignore[no-untyped-def]
    """Loads and friction in percent, negative where they oppose forward motion; ``drive`` is the current's torque."""
    total = torque(theta, omega, time, duty, p, on)
    level = grip_level(theta, omega, time, drive, direction, state, grip, p, on)
    if bristle:
        return total - level * state[BRISTLE] / p[BREAKAWAY]
    return total - level * direction


@inlined
def net_torque(theta, omega, time, duty, direction, mode, bristle, gain, grip, state, p, on):  # type: ignore[no-untyped-def]
    """Drive, loads and friction in percent, without the linear back-emf."""
    drive = settled_current(omega, time, duty, mode, gain, state, p, on)
    total = drive + omega / gain if mode != STANDBY else 0.0
    return total + resistance(theta, omega, time, duty, drive, direction, bristle, grip, state, p, on)


@inlined
def deflect(state, turn, p):  # type: ignore[no-untyped-def]
    """Carry the deflection before sliding over a turn of the shaft (Dahl 1968)."""
    if turn != 0.0:
        end = p[BREAKAWAY] if turn > 0.0 else -p[BREAKAWAY]
        state[BRISTLE] = end + (state[BRISTLE] - end) * exp(-abs(turn) / p[BREAKAWAY])


@inlined
def relax(state, omega, drive, dt, p, on):  # type: ignore[no-untyped-def]
    """Carry the warmth of winding and bearings over a step at about ``omega`` under a ``drive`` in percent."""
    if on[HEATING_ON]:
        # The losses are those of the hot winding; its resistance is taken to follow within the step.
        cold_loss = (drive / 100.0) ** 2
        falls = 1.0 - p[RISE] * cold_loss
        if abs(falls) * dt < 1e-9 * p[HEATING]:
            state[WINDING] += cold_loss * dt / p[HEATING]
        else:
            state[WINDING] = cold_loss / falls + (state[WINDING] - cold_loss / falls) * exp(-falls * dt / p[HEATING])
    if on[WARMING_ON]:
        warming = 1.0 if omega != 0.0 or p[WARMING_BY] == 1.0 else 0.0
        state[BEARING] = warming + (state[BEARING] - warming) * exp(-dt / p[WARMING])
