"""One segment of a PWM period: the linear motor exactly, all other effects at the middle of the step (second order).

A current that meets zero in a diode or the bridge's limit is located on the exact curve and the segment is cut there.
Where anything else happens (a start, a stop, a meeting in the gap, an end of travel), and where the machine is too
stiff for one step a segment, the adaptive integration takes the segment instead, with its own location of events.
"""

from __future__ import annotations

import math

from firmware_model.circuit import circuit, sign, starts
from firmware_model.compiled import part
from firmware_model.encoder import follow, read_encoder
from firmware_model.events import body_broken
from firmware_model.layout import (
    BODIES,
    CONTACT,
    CURRENT,
    EVENTS,
    FLOW,
    LOAD_OMEGA,
    LOAD_THETA,
    OMEGA,
    ON,
    OWN,
    PHASE,
    SIDE,
    SLIP,
    STATES,
    STEPS,
    STIFF,
    THETA,
    TIME,
    C,
)
from firmware_model.linear import BUILT, flow, keep, kept_flow
from firmware_model.physics import inertias, mechanical
from firmware_model.stepper import advance_step

R, L, KT, KE, B = int(C.R), int(C.L), int(C.KT), int(C.KE), int(C.B)
HALF_GAP, DEFLECTION = int(C.HALF_GAP), int(C.DEFLECTION)

# Rows of the workspace: inertias apart and together, then an exponential for each phase, winding and body.
BODY, TABLE = 9, 10
ROWS = 12
MOST_PIECES = 20
BROKEN = -1.0


@part
def clear(y, r, w, m, p, duty, on):  # type: ignore[no-untyped-def]
    """Forget the exponentials: the duty or an inertia has changed."""
    motor_j, load_j = inertias(r[TIME], y, duty, p, on)
    w[BODY, 0] = motor_j if m[BODIES] == 2 else motor_j + load_j
    w[BODY, 1] = motor_j + load_j
    for i in range(ROWS):
        w[TABLE + i, BUILT] = 0.0


@part
def coefficients(w, m, p, free):  # type: ignore[no-untyped-def]
    """The linear motor's matrix, and the index of its body: 0 held, 1 alone, 2 together with its load."""
    a11 = a12 = a21 = a22 = 0.0
    body = 0
    if m[SIDE] != 0:
        body = 2 if m[CONTACT] != 0 else 1
        a11, a12 = -p[B] / w[BODY, body - 1], p[KT] / w[BODY, body - 1]
    if free:
        a21, a22 = -p[KE] / p[L], -p[R] / p[L]
    return a11, a12, a21, a22, body


@part
def row_of(w, phase, h, free, body, a11, a12, a21, a22):  # type: ignore[no-untyped-def]
    """Place of the exponential over a whole segment of this phase, built when first asked for."""
    place = TABLE + 6 * (phase - ON) + body
    if free:
        place += 3
    if w[place, BUILT] == 0.0:
        keep(w[place], h, a11, a12, a21, a22)
        w[place, BUILT] = 1.0
    return place


@part
def landing(h, target, omega, current, rate, a11, a12, a21, a22, g1, g2):  # type: ignore[no-untyped-def]
    """When within ``h`` the current comes to ``target`` (beyond h: it does not): Newton from a parabola's root."""
    way = target - current
    if way * rate <= 0.0 or abs(way) > abs(rate) * h:  # a current slows down on its way to where it tends
        return 2.0 * h
    bend = a21 * (a11 * omega + a12 * current + g1) + a22 * rate
    inside = rate * rate + 2.0 * bend * way
    if inside <= 0.0:
        return 2.0 * h
    at = 2.0 * way / (rate + math.copysign(math.sqrt(inside), rate))
    for _ in range(8):
        if at > 2.0 * h:
            break
        speed, there, _ = flow(omega, current, at, a11, a12, a21, a22, g1, g2)
        step = (there - target) / (a21 * speed + a22 * there + g2)
        at = max(at - step, 0.0)
        if abs(step) <= 1e-7 * h:  # the next one would be its square
            break
    return at


@part
def attempt(y, r, w, m, duty, p, on, h, full):  # type: ignore[no-untyped-def]
    """A step of ``h`` or less from y into w[8]; ``full``: h is a whole segment.

    Returns how far it went: short of h where the current met zero or its limit, below 0 where a body's regime broke.
    """
    time, half = r[TIME], 0.5 * h
    middle, dy, end = w[0], w[1], w[8]
    omega, current = y[OMEGA], y[CURRENT]
    middle[THETA], middle[OMEGA] = y[THETA] + half * omega, omega
    for i in range(OWN, m[STATES]):
        middle[i] = y[i] + half * dy[i]
    volts, ohms, lost, most = circuit(time + half, middle, m, duty, p, on)
    push = volts - p[KE] * omega
    m[FLOW] = sign(current) if current != 0.0 else starts(push, lost)
    free = m[FLOW] != 0
    rate = 0.0
    if free:
        rate = (push - m[FLOW] * lost - ohms * current) / p[L]
        free = not ((current >= most and rate > 0.0) or (current <= -most and rate < 0.0))
    a11, a12, a21, a22, body = coefficients(w, m, p, free)

    # A current on its way to zero in a diode, or to its limit, cuts the segment there.
    target = math.nan
    if free and rate * current < 0.0 and lost > 0.0:
        target = 0.0
    elif free and most < math.inf:
        target = math.copysign(most, rate)
    if not math.isnan(target):
        g1 = w[BODY, 2] if body != 0 else 0.0
        g2 = (volts - m[FLOW] * lost - (ohms - p[R]) * current) / p[L]
        at = landing(h, target, omega, current, rate, a11, a12, a21, a22, g1, g2)
        if at < h:
            h, half, full = at, 0.5 * at, False
        else:
            target = math.nan

    between = current
    if free:
        between += half * rate / (1.0 + half * p[R] / p[L])
    middle[CURRENT] = between
    middle[THETA] = y[THETA] + half * omega
    middle[OMEGA] = omega + half * dy[OMEGA]
    if m[BODIES] == 2:
        middle[LOAD_THETA] = y[LOAD_THETA] + half * y[LOAD_OMEGA]
        middle[LOAD_OMEGA] = y[LOAD_OMEGA] + half * dy[LOAD_OMEGA]
    deflection = p[DEFLECTION]
    if deflection > 0.0:
        slip = y[SLIP] + half * omega * (1.0 - m[SIDE] * y[SLIP] / deflection)
        middle[SLIP] = min(max(slip, -deflection), deflection)
    for i in range(OWN, m[STATES]):
        middle[i] = y[i] + half * dy[i]
    mechanical(time + half, middle, dy, m, duty, p[KT] * between, p, on)

    g1 = g2 = 0.0
    if body != 0:
        g1 = dy[OMEGA] - a11 * middle[OMEGA] - a12 * between
        w[BODY, 2] = g1
    if free:
        g2 = (volts - m[FLOW] * lost - (ohms - p[R]) * between) / p[L]
    if full:
        place = row_of(w, m[PHASE], h, free, body, a11, a12, a21, a22)
        end[OMEGA], reached, turn = kept_flow(w[place], omega, current, g1, g2)
    else:
        end[OMEGA], reached, turn = flow(omega, current, h, a11, a12, a21, a22, g1, g2)
    if not math.isnan(target):
        reached = target
    elif free:
        if abs(reached) > most or (lost > 0.0 and reached * m[FLOW] < 0.0):
            return BROKEN
    elif m[FLOW] == 0 and starts(volts - p[KE] * end[OMEGA], lost) != 0:
        return BROKEN

    end[CURRENT] = reached
    end[THETA] = y[THETA] + turn
    if m[BODIES] == 2:
        if m[CONTACT] != 0:
            end[LOAD_THETA] = end[THETA] - m[CONTACT] * p[HALF_GAP]
            end[LOAD_OMEGA] = end[OMEGA]
        else:
            end[LOAD_THETA] = y[LOAD_THETA] + h * dy[LOAD_THETA]
            end[LOAD_OMEGA] = y[LOAD_OMEGA] + h * dy[LOAD_OMEGA]
    if deflection > 0.0:
        # dz/d(theta) = 1 - side z/breakaway, solved over the angle turned.
        limit = m[SIDE] * deflection
        end[SLIP] = limit + (y[SLIP] - limit) * math.exp(-m[SIDE] * turn / deflection) if m[SIDE] != 0 else y[SLIP]
    for i in range(OWN, m[STATES]):
        end[i] = y[i] + h * dy[i]
    return BROKEN if body_broken(time + h, end, m, duty, p, on) else h


@part
def segment(y, r, w, m, duty, p, on, finish, h, full):  # type: ignore[no-untyped-def]
    """Run one segment of ``h`` seconds to the time ``finish``."""
    end = w[8]
    for _ in range(MOST_PIECES):
        if m[STIFF] != 0:
            break
        passed = attempt(y, r, w, m, duty, p, on, h, full)
        if passed < 0.0:
            break
        m[STEPS] += 1
        for i in range(m[STATES]):
            y[i] = end[i]
        if passed >= h:
            r[TIME] = finish
            return
        m[EVENTS] += 1
        r[TIME] += passed
        h -= passed
        full = False
    fresh = True
    while r[TIME] < finish:
        fresh = advance_step(y, r, m, w, finish, p, on, duty, fresh)
        follow(y, m, p)
        read_encoder(y, r, m, p, on)
