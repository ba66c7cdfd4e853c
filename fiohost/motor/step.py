"""One step of the motor: which regime holds, its linear flow, the first event on the way, and what jumps there.

What depends on the state is taken at the beginning, carried half a step, and taken again at the predicted middle
(exponential midpoint rule, second order: Hochbruck and Ostermann 2010). In between a regime is linear and its flow is
exact. The regimes differ in what joins motor and load (rigid, play open or closed, a spring), in what rests, and in
whether the current lags. A step ends where a margin that is positive within the regime falls below zero.
"""

from __future__ import annotations

from math import ceil, inf, isnan

from fiohost.motor.compiled import inlined, sign
from fiohost.motor.electrics import loses, simple_winding, winding
from fiohost.motor.events import (
    ALIKE,
    END,
    ENGAGING,
    NO_CURRENT,
    OPEN_GAP_S,
    PARTING,
    PLAY,
    RELEASE,
    REST,
    RIGID,
    SPRING,
    TOUCH,
    judge,
    locate,
    strain_of,
)
from fiohost.motor.flow import SAME_TIME_S, flow, flow_again, mean_current
from fiohost.motor.hooks import (
    NO_BRISTLE,
    barred,
    bristle,
    carry,
    friction,
    jumped,
    load,
    torque,
)
from fiohost.motor.state import (
    DRIVE,
    HALF,
    MIDDLE,
    MOST_STEPS,
    STANDBY,
    WHOLE,
)


@inlined
def advance(at, x, duty, mode, time, span, substep, kind, lag, lost, has, more, special, p, on):  # type: ignore[no-untyped-def]
    """The motor, ``at`` a state, after a span of constant command. ``kind`` is what joins the load, ``lost`` what
    ``electrics.losses`` says of the winding, ``has`` what ``body.asked`` says.

    A caller says as constants what kind of motor it is, so that the rest is left out of its code: ``kind``, whether
    there is ``more`` than friction and torques (ends of travel, bristles, states of effects' own, a voltage or
    resistance that changes), and a ``special`` circuit, whose current may cease or be limited within a PWM period.
    """
    pulls, loads, remembering, ending, bristly, rubbing, forward, reverse, extra, bodies = has
    _, per_gain, mass, own, other, per_own, per_other, _, _, half_gap = bodies
    if not more:
        remembering = ending = bristly = False
        lost = (0.0, inf, False, False, False, -1.0) if not special else lost
    if lost[2] and mode == DRIVE and duty == 0.0:
        mode = STANDBY  # no pulse at all leaves a bridge open that is open between pulses; a brake shorts it
    lossy = special and loses(mode, p, on)
    theta, omega, load_theta, load_speed, contact, flowing, kept = at
    left, released = span, False
    for k in range(MOST_STEPS):
        if left <= SAME_TIME_S:
            break
        joined = kind == RIGID or (kind == PLAY and contact != 0.0)
        sprung = kind == SPRING and (half_gap == 0.0 or contact != 0.0)
        amps, load_omega, load_at, twist = flowing, omega, theta, 0.0
        dt = left
        if substep > 0.0 and k < MOST_STEPS - 1:
            dt = left / max(ceil(left / substep - ALIKE), 1)  # equal parts: what was computed for one serves all
        if kind != RIGID:
            load_at = load_theta
            twist = theta - load_at
            if not joined:
                load_omega = load_speed
            if half_gap > 0.0 and contact == 0.0:
                dt = min(dt, OPEN_GAP_S)

        when, shift, free, way, settled = time, 0, -1, 0.0, kept != 0.0
        direction, stuck, stuck_load, parts, hold, rest = sign(omega), False, False, False, 0.0, 0.0
        harder = 0.0
        turn, w, i, s, v, h, push = 0.0, omega, amps, twist, load_omega, 0.0, 0.0
        motion, forces = (omega, amps, twist, load_omega), (0.0, 0.0, 0.0)
        end = (0.0, omega, amps, twist, load_omega)
        regime = (joined, sprung, False, False, True, 0.0, 1.0, contact)
        current, bristled, until = (inf, 0.0, False), False, inf
        for middle in range(2):
            if special:
                push, volts, ohms, until, way, free = winding(
                    w, i, when, duty, mode, per_gain, lag, lost, free, way, settled, x, shift, p, on
                )
            else:
                push, volts, ohms, free = simple_winding(w, i, when, duty, mode, per_gain, lag, lost, x, shift, p, on)
            if middle == 0 and free != 1:
                amps, settled = push, free == 2
                motion = (omega, amps, twist, load_omega)
            elif middle == 1 and free == 1:
                # What depends on the current meets its mean: it may settle within a small part of the step.
                push = mean_current(amps, volts - w * per_gain, ohms, lag, dt)
            q = theta + turn
            rest = torque((q, w, when), p, on) if pulls else 0.0
            beyond = load((q - s, v, when), p, on) if loads else 0.0
            total = push + rest + (beyond if joined else 0.0)
            if sprung:
                total -= strain_of(s, w - v, contact, bodies)
            slack = NO_BRISTLE
            if bristly:
                slack = bristle(NO_BRISTLE, (), x, shift, p, on)
                bristled = not isnan(slack)
            slides = sign(slack) if bristled else direction
            if slides == 0.0:
                slides = 1.0 if total > 0.0 else -1.0
            level = forward if slides > 0.0 else reverse
            if rubbing:
                level = max(friction(0.0, (q, w, when, push, slides), x, shift, p, on), 0.0)
            if direction == 0.0:
                direction = slides if not bristled else (1.0 if total > level * slack else -1.0)
            if middle == 0:
                hold = level + extra
                if omega == 0.0:
                    held = ending and joined and barred((load_at, direction), p, on)
                    stuck = held or not (bristled or released or abs(total) > hold)
                if kind == PLAY and joined:
                    # In contact they stay together unless each by itself would go its own way.
                    alone, rate = push + rest, beyond * per_other
                    if bristled:
                        alone -= level * slack
                    elif omega == 0.0 and abs(alone) <= hold:
                        alone = 0.0
                    else:
                        alone -= level * (sign(omega) if omega != 0.0 else sign(alone))
                    if ending and omega == 0.0 and barred((load_at, sign(beyond)), p, on):
                        rate = 0.0
                    parts = contact * (alone * per_own - rate) < -ALIKE * (abs(alone) * per_own + abs(rate))
                elif not joined and ending and load_omega == 0.0:
                    pull = beyond + (strain_of(twist, omega, contact, bodies) if sprung else 0.0)
                    stuck_load = barred((load_at, sign(pull)), p, on)
            elif stuck and i != amps:
                harder = (level + extra - hold) / (i - amps)  # friction that grows with the current
            forces = (volts, rest - (level * slack if bristled else level * direction), beyond)
            emf, lags = free == 1 or mode != STANDBY, lag if free == 1 else 0.0
            regime = (joined, sprung, stuck, stuck_load, emf, lags, ohms, contact)
            current = (until, way, lossy)
            if parts:
                break
            half = middle == 0 and substep > 0.0
            h = 0.5 * dt if half else dt
            end = flow(motion, forces, bodies, regime, h, x, HALF if half else WHOLE)
            if not half:
                break
            turn, w, i, s, v = end
            if w * direction < 0.0 and not (bristled and omega == 0.0):
                w = 0.0
            when = time + h
            if remembering:
                carry(x, MIDDLE, turn / h, 0.5 * (push + i), h, p, on)
                shift = MIDDLE
        if parts:
            contact = 0.0
            continue

        if omega == 0.0 and not stuck and not bristled and end[1] * direction <= 0.0:
            # What holds it grew with its start.
            stuck = True
            regime = (joined, sprung, True, stuck_load, regime[4], regime[5], regime[6], contact)
            end = flow_again(motion, forces, bodies, regime, h, x, WHOLE)
        place = (kind, load_at, direction, hold, harder, rest, bristled, ending)
        found, event = judge(end, motion, forces, bodies, regime, current, place, p, on)
        happens = found < 0.0 and k < MOST_STEPS - 1  # no time is lost, whatever absurd constants do
        if happens:
            end, h, event = locate(end, found, event, h, motion, forces, bodies, regime, current, place, x, p, on)
        turn, w, i, s, v = end
        if remembering:
            carry(x, 0, turn / h if h > 0.0 else 0.0, push, h, p, on)
        theta += turn
        beyond_at = theta - s
        released = False
        if happens:
            if event == REST:
                w = 0.0
                v = 0.0 if joined else v
            elif event == END:
                came = sign(v)
                beyond_at, v = jumped(beyond_at, v, p, on)
                if kind == PLAY and joined and contact != came:
                    contact = 0.0  # a motor that pushes it stops with it, one that held it back goes on
                elif joined:
                    theta, w = beyond_at + s, v
            elif event == TOUCH:
                contact = sign(s)
                beyond_at = theta - contact * half_gap
                together = (own * w + other * v) / mass
                if ending and v == 0.0 and barred((beyond_at, sign(together)), p, on):
                    together = 0.0
                w = v = together
            elif event == PARTING:
                contact = 0.0
            elif event == ENGAGING:
                contact = 0.0 if sprung else sign(s)
            elif event == RELEASE:
                released = True
            elif event == NO_CURRENT:
                i = 0.0
            else:
                i, settled = current[0], True
        omega, load_speed, flowing, kept = w, v, i, 1.0 if settled else 0.0
        if kind != RIGID:
            load_theta = beyond_at
        elif half_gap > 0.0:
            load_theta = min(max(load_theta, theta - half_gap), theta + half_gap)
        left -= h
        time += h
    return theta, omega, load_theta, load_speed, contact, flowing, kept
