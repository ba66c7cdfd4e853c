"""The encoder: a disc whose edges change the levels A and B, and the decoder that counts them.

Levels are A + 2 B. Counting up A leads: 00, 10, 11, 01 (A first), and so on; each change of one level is a count (x4).
A change of both at once is invalid: nobody can tell which way, and nothing is counted.
"""

from __future__ import annotations

import math

from firmware_model.compiled import part
from firmware_model.hooks import measure
from firmware_model.layout import (
    BODIES,
    COUNT,
    DIRECTION,
    EDGES,
    INVALID,
    LEVELS,
    LOAD_THETA,
    LOOKS,
    LOST,
    REALS,
    THETA,
    TIME,
    C,
)

AFTER, HALF_GAP, QUANTUM = int(C.AFTER), int(C.HALF_GAP), int(C.QUANTUM)
ANGLE_ZERO, SHARE_LOST = int(C.ANGLE_ZERO), int(C.SHARE_LOST)
STATES = 4  # of the levels, in a period of the disc
LOOK = 3  # numbers kept of a look at the disc: time, angle in counts, edges that did not show


@part
def levels_of(state):  # type: ignore[no-untyped-def]
    """Levels of the disc in a state, counted upwards from 0 without end."""
    state = state % 4
    return state ^ (state >> 1)


@part
def decode(before, after):  # type: ignore[no-untyped-def]
    """Counts that the decoder makes of a change of levels, 1, 0 or -1, and whether it was invalid (1, else 0)."""
    turned = ((after ^ (after >> 1)) - (before ^ (before >> 1))) % 4
    if turned == 2:
        return 0, 1
    return (turned if turned < 2 else -1), 0


@part
def take(m, levels):  # type: ignore[no-untyped-def]
    """The decoder's registers take up new levels."""
    counts, invalid = decode(m[LEVELS], levels)
    m[LEVELS] = levels
    m[INVALID] += invalid
    if counts != 0:
        m[COUNT] += counts
        m[DIRECTION] = 0 if counts > 0 else 1


@part
def follow(y, m, p):  # type: ignore[no-untyped-def]
    """The far side of a gap that has no mass of its own stays within the play."""
    if m[BODIES] == 1 and p[HALF_GAP] > 0.0:
        y[LOAD_THETA] = min(max(y[LOAD_THETA], y[THETA] - p[HALF_GAP]), y[THETA] + p[HALF_GAP])


@part
def read_encoder(y, r, m, p, on):  # type: ignore[no-untyped-def]
    """Follow the edges since the last look; between two looks the disc has turned one way only.

    ``r[EDGES]`` is the true count of edges so far, ``m[COUNT]`` what the decoder made of them.
    """
    angle = y[LOAD_THETA] if p[AFTER] > 0.0 else y[THETA]
    at = measure(angle, p, on) / p[QUANTUM]
    edges = math.floor(at) - p[ANGLE_ZERO]
    passed = edges - r[EDGES]
    if passed != 0.0:
        r[EDGES] = edges
        if p[SHARE_LOST] > 0.0:
            # Every edge adds its share to the loss; a whole one does not show in the levels.
            r[LOST] += abs(passed) * p[SHARE_LOST]
            missed = min(math.floor(r[LOST]), abs(passed))
            r[LOST] -= missed
            passed -= math.copysign(missed, passed)
    if m[LOOKS] >= 0:
        place = REALS + LOOK * m[LOOKS]
        if place + LOOK <= len(r):
            r[place], r[place + 1], r[place + 2] = r[TIME], at - p[ANGLE_ZERO], passed
        m[LOOKS] += 1
    if passed == 0.0:
        return
    way = 1 if passed > 0.0 else -1
    left = int(abs(passed))
    if left > STATES:  # the decoder counts four in a period, each time round
        m[COUNT] += way * (left - left % STATES)
        m[DIRECTION] = 0 if way > 0 else 1
        left %= STATES
    state = m[LEVELS] ^ (m[LEVELS] >> 1)
    while left > 0:
        state += way
        left -= 1
        take(m, levels_of(state))
