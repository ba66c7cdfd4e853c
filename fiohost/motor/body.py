"""One rigid body whose current has no lag and whose torques stay the same over a hold, as in most models.

Nothing but friction is to be decided, and a hold is one step: speed follows one exponential, and when it comes to rest
is known. Torques are asked for once a hold.
"""

from __future__ import annotations

from fiohost.motor.compiled import inlined
from fiohost.motor.flow import one_body, time_to_rest
from fiohost.motor.hooks import (
    any_of,
    breakaway,
    bristles,
    ends,
    friction,
    inertia,
    loaded,
    pulled,
    remembers,
    rubs,
)
from fiohost.motor.state import (
    GAIN,
    PART,
    STANDBY,
    WHOLE,
)

_varies = any_of("rate", "event", "resistance", "drop", "ceiling", "opens", "coasts", "bristle")


@inlined
def is_steady(substep, on):  # type: ignore[no-untyped-def]
    """Whether torques and voltage stay the same over a hold."""
    return substep == 0.0 and not _varies(on)


@inlined
def asked(joint, time, x, p, on):  # type: ignore[no-untyped-def]
    """What stays as it is from a time on, until the plant changes: whether there are torques, loads, states of effects'
    own, ends of travel, bristles, friction that varies within a hold; sliding friction forward and in reverse where it
    does not, break-away above that; and the bodies: gain and one over it, inertia of all, of the motor and of the load,
    one over these two, stiffness, damping and half the gap of what joins them.
    """
    _, share, half_gap, stiff, damp, mass = joint
    mass *= inertia(1.0, (time,), p, on)
    own, other = mass * (1.0 - share), mass * share
    per_other = 1.0 / other if other > 0.0 else 0.0
    bodies = (p[GAIN], 1.0 / p[GAIN], mass, own, other, 1.0 / own, per_other, stiff, damp, half_gap)
    forward = max(friction(0.0, (0.0, 0.0, time, 0.0, 1.0), x, 0, p, on), 0.0)
    reverse = max(friction(0.0, (0.0, 0.0, time, 0.0, -1.0), x, 0, p, on), 0.0)
    return (
        pulled(on), loaded(on), remembers(on), ends(on), bristles(on), rubs(on), forward, reverse,
        breakaway((), p, on), bodies,
    )  # fmt: skip


@inlined
def glide(at, x, volts, mode, span, force, has):  # type: ignore[no-untyped-def]
    """The body, ``at`` a state, after a span of constant voltage, in percent, and a constant torque."""
    _, _, _, _, _, _, forward, reverse, extra, (gain, per_gain, mass, _, _, _, _, _, _, half_gap) = has
    emf, tau = mode != STANDBY, gain * mass
    if not emf:
        volts = 0.0
    theta, omega, load_theta, _, contact, _, _ = at
    amps, left = volts, span
    if omega != 0.0:
        net = force - forward if omega > 0.0 else force + reverse
        turn, after, amps = one_body(omega, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, span, x, WHOLE)
        left = 0.0
        if after * omega < 0.0:
            h = time_to_rest(omega, volts, net, gain, tau, emf, span)
            turn, _, _ = one_body(omega, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, h, x, PART)
            after, left = 0.0, span - h
        theta, omega = theta + turn, after
        load_theta = _trail(load_theta, theta, half_gap)
    if left > 0.0:
        amps, push = volts, volts + force
        if push > forward + extra or push < -reverse - extra:
            net = force - forward if push > 0.0 else force + reverse
            at = WHOLE if left == span else PART
            turn, after, flowing = one_body(0.0, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, left, x, at)
            if after * push > 0.0:
                theta, omega, amps = theta + turn, after, flowing
        load_theta = _trail(load_theta, theta, half_gap)
    return theta, omega, load_theta, omega, contact, amps, 0.0


@inlined
def _trail(load_theta, theta, half_gap):  # type: ignore[no-untyped-def]
    """Where a load without inertia is that trails the motor through its play."""
    if half_gap > 0.0:
        return min(max(load_theta, theta - half_gap), theta + half_gap)
    return load_theta
