"""The motor under a PWM whose edges are resolved: each period as its on and its off segment.

The timer counts up from power-on in whole periods and the pulse stands at the beginning of each. A command that takes
effect within a period acts at once, with its own edge. The encoder is read where a motion may turn round, which always
is an event, and at the end of a hold: in between the disc turns one way, and its counter passes the same edges.
"""

from __future__ import annotations

import math

from firmware_model.circuit import DRIVEN
from firmware_model.compiled import part
from firmware_model.encoder import follow, read_encoder
from firmware_model.events import settle
from firmware_model.layout import (
    DUTY,
    FOLDED,
    LOST_WAY,
    MODE,
    OFF,
    ON,
    PHASE,
    PLAIN,
    STEPS,
    TIME,
    C,
)
from firmware_model.periods import forget, leap
from firmware_model.segments import clear, segment

PERIOD = int(C.PERIOD)
MOST_STEPS = 200_000  # beyond those of the segments themselves
NEAR = 1e-6  # of a period: times this near are the same edge


@part
def run_edges(y, r, m, w, until, p, on):  # type: ignore[no-untyped-def]
    """Motion under one command."""
    duty, period = r[DUTY], p[PERIOD]
    share = min(0.01 * abs(duty), 1.0) if m[MODE] == DRIVEN else 0.0
    patience = m[STEPS] + MOST_STEPS + int(10.0 * (until - r[TIME]) / period)
    clear(y, r, w, m, p, duty, on)
    forget(w)
    begun = False
    while r[TIME] < until:
        if m[STEPS] > patience:
            m[LOST_WAY] = 1
            r[TIME] = until
            return
        number = math.floor(r[TIME] / period + NEAR)
        into = r[TIME] / period - number
        if into < NEAR:
            into = 0.0
        m[PHASE] = ON if into < share - NEAR else OFF
        if not begun:
            settle(r[TIME], y, m, duty, p, on)
            begun = True
        if m[PLAIN] != 0 and m[FOLDED] == 0 and into == 0.0:
            whole = int((until - r[TIME]) / period + NEAR)
            passed = leap(y, w, m, p, duty, share, whole) if whole > 0 else 0
            if passed > 0:
                r[TIME] = until if until - (number + passed) * period < NEAR * period else (number + passed) * period
                m[STEPS] += 1
                continue
        edge = share if m[PHASE] == ON else 1.0
        finish = (number + edge) * period
        full = into == 0.0 or abs(into - share) < NEAR
        h = (share if m[PHASE] == ON else 1.0 - share) * period
        if finish > until + NEAR * period:
            finish, full = until, False
        elif finish > until - NEAR * period:
            finish = until
        if not full:
            h = finish - r[TIME]
        segment(y, r, w, m, duty, p, on, finish, h, full)
        follow(y, m, p)
        if m[FOLDED] != 0:
            read_encoder(y, r, m, p, on)
    read_encoder(y, r, m, p, on)
