"""One rigid body whose current has no lag, as most models are: its own step, in closed form from event to event.

It does what ``step`` does where nothing but friction, an end of travel and the state of an effect's own is to be
decided: between events speed follows one exponential, and when it comes to rest is known. Where torques stay the same
over a hold, they are asked for once.
"""

from __future__ import annotations

from math import isnan

from fiohost.motor.compiled import inlined, part, sign
from fiohost.motor.electrics import simple_winding
from fiohost.motor.events import LOOKS, SURE_S
from fiohost.motor.flow import SAME_TIME_S, one_body, time_to_rest
from fiohost.motor.hooks import (
    NO_BRISTLE,
    any_of,
    barred,
    breakaway,
    bristle,
    bristles,
    carry,
    ends,
    friction,
    inertia,
    jumped,
    load,
    loaded,
    margin,
    pulled,
    remembers,
    rubs,
    torque,
)
from fiohost.motor.state import (
    DRIVE,
    GAIN,
    HALF,
    MIDDLE,
    MOST_STEPS,
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


@inlined
def _acting(theta, omega, time, duty, mode, direction, per_gain, lost, has, x, shift, p, on):  # type: ignore[no-untyped-def]
    """Current, voltage, torque, sliding friction, the direction in which the body moves or would, whether a bristle
    holds it, and the share of friction, with its sign, that acts.
    """
    pulls, loads, _, _, bristly, rubbing, forward, reverse, _, _ = has
    push, volts, _, _ = simple_winding(omega, 0.0, time, duty, mode, per_gain, 0.0, lost, x, shift, p, on)
    force = torque((theta, omega, time), p, on) if pulls else 0.0
    if loads:
        force += load((theta, omega, time), p, on)
    total, bristled, slides, slack = push + force, False, direction, NO_BRISTLE
    if bristly:
        slack = bristle(NO_BRISTLE, (), x, shift, p, on)
        bristled = not isnan(slack)
        if bristled:
            slides = sign(slack)
    if slides == 0.0:
        slides = 1.0 if total > 0.0 else -1.0
    level = forward if slides > 0.0 else reverse
    if rubbing:
        level = max(friction(0.0, (theta, omega, time, push, slides), x, shift, p, on), 0.0)
    if not bristled:
        return push, volts, force, level, slides, False, slides
    if direction == 0.0:
        direction = 1.0 if total > level * slack else -1.0
    return push, volts, force, level, direction, True, slack


@inlined
def slide(at, x, duty, mode, time, span, substep, lost, has, p, on):  # type: ignore[no-untyped-def]
    """The body, ``at`` a state, after a span of constant command; the arguments are those of ``step``."""
    _, _, remembering, ending, _, _, _, _, extra, (gain, per_gain, mass, _, _, _, _, _, _, half_gap) = has
    tau = gain * mass
    if lost[2] and mode == DRIVE and duty == 0.0:
        mode = STANDBY
    theta, omega, load_theta, _, contact, amps, _ = at
    emf, left = mode != STANDBY, span
    for k in range(MOST_STEPS):
        if left <= SAME_TIME_S:
            break
        h = min(left, substep) if substep > 0.0 and k < MOST_STEPS - 1 else left
        push, volts, force, level, direction, bristled, slack = _acting(
            theta, omega, time, duty, mode, sign(omega), per_gain, lost, has, x, 0, p, on
        )
        stuck = False
        if omega == 0.0:
            stuck = not (bristled or abs(push + force) > level + extra)
            if ending and barred((theta, direction), p, on):
                stuck = True
        if substep > 0.0:
            half, turn, middle, amps = 0.5 * h, 0.0, 0.0, volts
            per_half = 1.0 / half
            if not stuck:
                net = force - level * slack
                turn, middle, amps = one_body(omega, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, half, x, HALF)
                if middle * direction < 0.0 and not (bristled and omega == 0.0):
                    middle = 0.0
            shift = 0
            if remembering:
                carry(x, MIDDLE, turn * per_half, 0.5 * (push + amps), half, p, on)
                shift = MIDDLE
            push, volts, force, level, _, bristled, slack = _acting(
                theta + turn, middle, time + half, duty, mode, direction, per_gain, lost, has, x, shift, p, on
            )
        net = force - level * slack
        turn, after, amps, ended = 0.0, 0.0, volts, False
        if not stuck:
            turn, after, flowing = one_body(omega, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, h, x, WHOLE)
            if omega == 0.0 and not bristled and after * direction <= 0.0:
                turn, after = 0.0, 0.0  # what holds it grew with its start
            else:
                amps = flowing
                if after * direction < 0.0 and omega != 0.0 and k < MOST_STEPS - 1:
                    h = time_to_rest(omega, volts, net, gain, tau, emf, h)
                    turn, _, amps = one_body(omega, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, h, x, PART)
                    after = 0.0
                if ending and margin((theta + turn, after), p, on) < 0.0:
                    ended = True
                    turn, after, amps, h = _end(theta, omega, volts, net, gain, per_gain, tau, emf, h, x, p, on)
        if remembering:
            carry(x, 0, turn / h if h > 0.0 else 0.0, push, h, p, on)
        theta, omega = theta + turn, after
        if ended:
            theta, omega = jumped(theta, omega, p, on)
        load_theta = _trail(load_theta, theta, half_gap)
        left -= h
        time += h
    return theta, omega, load_theta, omega, contact, amps, 0.0


@part
def _end(theta, omega, volts, net, gain, per_gain, tau, emf, h, x, p, on):  # type: ignore[no-untyped-def]
    """Turn, speed and current just beyond an end of travel that is reached within ``h``, and when, by halving."""
    low, high = 0.0, h
    for _ in range(LOOKS):
        if high - low <= SURE_S:
            break
        h = 0.5 * (low + high)
        turn, after, _ = one_body(omega, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, h, x, PART)
        if margin((theta + turn, after), p, on) < 0.0:
            high = h
        else:
            low = h
    turn, after, amps = one_body(omega, 0.0, volts, net, gain, per_gain, tau, 0.0, 1.0, emf, high, x, PART)
    return turn, after, amps, high
