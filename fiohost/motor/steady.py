"""One rigid body under torques that stay the same over a hold, the plainest of regimes: its closed form, to rest and on.

It does what ``step`` does where that has nothing to decide: nothing depends on angle or speed, no current lags, no
effect has a state. Most models of a search are so, and need no step of the whole motor.
"""

from __future__ import annotations

from fiohost.motor.compiled import inlined
from fiohost.motor.events import RIGID
from fiohost.motor.flow import one_body, time_to_rest
from fiohost.motor.hooks import any_of, breakaway, friction, inertia, load, torque
from fiohost.motor.state import CURRENT, GAIN, HELD, LOAD_OMEGA, LOAD_THETA, OMEGA, PART, STANDBY, THETA, WHOLE

_varies = any_of("rate", "event", "lag", "resistance", "drop", "ceiling", "opens", "bristle")


@inlined
def is_steady(joint, substep, on):  # type: ignore[no-untyped-def]
    """Whether a model, joined as ``kernel.joint_of`` says, is one rigid body under torques that stay the same."""
    return joint[0] == RIGID and substep == 0.0 and not _varies(on)


@inlined
def torques(joint, time, x, p, on):  # type: ignore[no-untyped-def]
    """What acts on the body from a time on: gain and one over it, time constant, torque, sliding friction forward and in reverse, and
    what holds it at rest beyond that.
    """
    tau = p[GAIN] * joint[5] * inertia(1.0, (time,), p, on)
    force = torque((0.0, 0.0, time), p, on) + load((0.0, 0.0, time), p, on)
    forward = max(friction(0.0, (0.0, 0.0, time, 0.0, 1.0), x, 0, p, on), 0.0)
    reverse = max(friction(0.0, (0.0, 0.0, time, 0.0, -1.0), x, 0, p, on), 0.0)
    return p[GAIN], 1.0 / p[GAIN], tau, force, forward, reverse, breakaway((), p, on)


@inlined
def glide(x, volts, mode, span, half_gap, acting):  # type: ignore[no-untyped-def]
    """Carry the body over a span of constant voltage, in percent, under what ``torques`` says acts on it."""
    gain, per_gain, tau, force, forward, reverse, extra = acting
    emf = mode != STANDBY
    if not emf:
        volts = 0.0
    theta, omega, amps, left = x[THETA], x[OMEGA], volts, span
    if omega != 0.0:
        net = force - forward if omega > 0.0 else force + reverse
        turn, after, amps = one_body(omega, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, span, x, WHOLE)
        left = 0.0
        if after * omega < 0.0:
            h = time_to_rest(omega, volts, net, gain, tau, emf, span)
            turn, _, _ = one_body(omega, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, h, x, PART)
            after, left = 0.0, span - h
        theta, omega = theta + turn, after
    if half_gap > 0.0:
        x[LOAD_THETA] = min(max(x[LOAD_THETA], theta - half_gap), theta + half_gap)
    if left > 0.0:
        amps, push = volts, volts + force
        if push > forward + extra or push < -reverse - extra:
            net = force - forward if push > 0.0 else force + reverse
            at = WHOLE if left == span else PART
            turn, after, flowing = one_body(0.0, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, left, x, at)
            if after * push > 0.0:
                theta, omega, amps = theta + turn, after, flowing
    x[THETA], x[OMEGA], x[LOAD_OMEGA], x[CURRENT], x[HELD] = theta, omega, omega, amps, 0.0
    if half_gap > 0.0:
        x[LOAD_THETA] = min(max(x[LOAD_THETA], theta - half_gap), theta + half_gap)
