"""Where a regime ends: how far a state is from each event that the regime has, and the first of them within a step.

Margins are positive within the regime and fall below zero beyond an event. Each is smooth along the linear flow, so the
first time at which the least of them is zero is found on the flow itself.
"""

from __future__ import annotations

from math import inf

from fiohost.motor.compiled import inlined, part, sign
from fiohost.motor.flow import flow, time_to_rest
from fiohost.motor.hooks import barred, margin
from fiohost.motor.state import PART

# What joins the load: nothing that matters, a contact with play, a spring (with play, where it has any).
RIGID, PLAY, SPRING = 0, 1, 2
# An open gap is looked at this often: a touch in between that lasts no longer is missed.
OPEN_GAP_S = 1e-3
# Events, each with the state in which it leaves the motor.
REST, END, TOUCH, PARTING, ENGAGING, RELEASE, NO_CURRENT, SETTLED = range(8)
# An event is located to this time, in so many looks at the most; currents and forces are equal that are so close.
SURE_S, LOOKS = 1e-12, 80
ALIKE = 1e-9


@inlined
def strain_of(twist, closing, contact, bodies):  # type: ignore[no-untyped-def]
    """Torque of a spring whose play is closed on one side, in percent; ``closing`` is the rate of the twist."""
    _, _, _, _, _, _, _, stiff, damp, half_gap = bodies
    return stiff * (twist - contact * half_gap) + damp * closing


@inlined
def judge(end, motion, forces, bodies, regime, current, place, p, on):  # type: ignore[no-untyped-def]
    """How far the end of a step is from the nearest event (below 0: beyond it), and which."""
    turn, w, i, s, v = end
    omega, amps, _, _ = motion
    volts, force, beyond = forces
    _, per_gain, _, _, _, per_own, per_other, stiff, _, half_gap = bodies
    joined, sprung, stuck, stuck_load, emf, lag, _, contact = regime
    until, way, lossy = current
    kind, load_at, direction, hold, harder, rest, bristled, ending = place
    found, event = inf, REST
    if omega != 0.0 and not stuck:
        found = w * direction
    if ending and not stuck_load and not (joined and stuck):
        there = margin((load_at + turn - (s - motion[2]), v), p, on)
        if there < found:
            found, event = there, END
    if kind == PLAY and not joined:
        gap = half_gap * (1.0 + ALIKE) - abs(s)  # rounding alone is no touch
        if gap < found and (w - v) * s > 0.0:
            found, event = gap, TOUCH
    elif kind == PLAY and not stuck:
        # What is taken at the step's middle may have them apart at its beginning: then the next step begins with that.
        began = amps if lag > 0.0 else volts - (omega * per_gain if emf else 0.0)
        rate = beyond * per_other
        apart, tiny = contact * ((i + force) * per_own - rate), ALIKE * (abs(force) * per_own + abs(rate))
        if apart < min(found, -tiny) and contact * ((began + force) * per_own - rate) > -tiny:
            found, event = apart, PARTING
    elif kind == SPRING and half_gap > 0.0:
        if sprung:
            apart = min(contact * strain_of(s, w - v, contact, bodies), stiff * (contact * s - half_gap + ALIKE))
        else:
            apart = stiff * (half_gap - abs(s))
            if apart < 0.0:
                apart = -sign(s) * strain_of(s, w - v, sign(s), bodies)
        if apart < found:
            found, event = apart, ENGAGING
    if stuck and not bristled and (lag > 0.0 or sprung):
        pull = i + rest + (beyond if joined else 0.0)
        if sprung:
            pull -= strain_of(s, w - v, contact, bodies)
        holds = hold + harder * (i - amps) - abs(pull)
        if holds < found and not (joined and ending and barred((load_at, sign(pull)), p, on)):
            found, event = holds, RELEASE
    if stuck_load and sprung:
        pull = beyond + strain_of(s, w - v, contact, bodies)
        if -abs(pull) < found and not barred((load_at, sign(pull)), p, on):
            found, event = -abs(pull), RELEASE
    if lag > 0.0:
        if lossy and amps != 0.0 and i * way < found:
            found, event = i * way, NO_CURRENT
        if until != inf and (until - i) * sign(until - amps) < found:
            found, event = (until - i) * sign(until - amps), SETTLED
    return found, event


@part
def locate(end, found, event, h, motion, forces, bodies, regime, current, place, x, p, on):  # type: ignore[no-untyped-def]
    """The first time within ``h`` just beyond an event, the state there, and which event: a false position that halves
    now and then (Dowell and Jarratt 1971).
    """
    low, high, before, beyond = 0.0, h, inf, found
    simple = regime[5] == 0.0 and not regime[1]
    for look in range(LOOKS):
        if high - low <= SURE_S:
            break
        if look == 0 and event == REST and simple:
            # In closed form, if nothing else comes before it.
            body = bodies[2] if regime[0] else bodies[3]
            force = forces[1] + forces[2] if regime[0] else forces[1]
            h = time_to_rest(motion[0], forces[0], force, bodies[0], bodies[0] * body, regime[4], high)
        elif before == inf or look % 3 == 2:
            h = 0.5 * (low + high)
        else:
            h = low + (high - low) * before / (before - beyond)
            h = min(max(h, low + 1e-3 * (high - low)), high - 1e-3 * (high - low))
        trial = flow(motion, forces, bodies, regime, h, x, PART)
        there, which = judge(trial, motion, forces, bodies, regime, current, place, p, on)
        if look == 0 and event == REST and simple and abs(there) <= ALIKE * abs(motion[0]):
            return trial, h, event
        if there < 0.0:
            high, beyond, end, event = h, there, trial, which
        else:
            low, before = h, there
    return end, high, event
