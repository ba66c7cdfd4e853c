"""The kernel called from Python: commands in time, motion in between, the encoder's edges on the way."""

from __future__ import annotations

from firmware_model.circuit import DRIVEN, STANDBY
from firmware_model.compiled import entry, part
from firmware_model.edges import run_edges
from firmware_model.encoder import follow, read_encoder
from firmware_model.events import settle
from firmware_model.hooks import command
from firmware_model.layout import (
    COUNT,
    CURRENT,
    DUTY,
    FLOW,
    FOLDED,
    HEAD,
    LOOKS,
    LOST_WAY,
    MEAN,
    MODE,
    OMEGA,
    PHASE,
    QUEUE,
    STEPS,
    TIME,
    WAITING,
    C,
)
from firmware_model.physics import CEASING, electrical
from firmware_model.stepper import advance_step

DELAY = int(C.DELAY)
R, L, KE = int(C.R), int(C.L), int(C.KE)
NO_COMMAND = -1
MOST_STEPS = 200_000  # in one hold; usual are one to ten
FAST, CHANGED = int(C.FAST), int(C.CHANGED)
CHANGE_AT = int(C.CHANGE_AT)


@part
def run_until(y, r, m, w, until, p, on):  # type: ignore[no-untyped-def]
    """Motion under one command."""
    fresh = True
    patience = m[STEPS] + MOST_STEPS
    while r[TIME] < until:
        if m[STEPS] > patience:
            m[LOST_WAY] = 1  # told to the caller; without this a plant of absurd constants would never return
            r[TIME] = until
            return
        fresh = advance_step(y, r, m, w, until, p, on, r[DUTY], fresh)
        follow(y, m, p)
        if fresh or m[FOLDED] != 0:  # a motion turns round only at an event: until then the same edges pass
            read_encoder(y, r, m, p, on)
    read_encoder(y, r, m, p, on)


@part
def act(y, r, m, p, on, mode, duty):  # type: ignore[no-untyped-def]
    """A command takes effect at the bridge."""
    if m[FLOW] == CEASING:
        y[CURRENT], _ = electrical(r[TIME], y, m, r[DUTY], p, on)
    r[DUTY] = command(duty, p, on)
    m[MODE] = mode
    if p[FAST] > 0.0 and mode == DRIVEN and r[DUTY] == 0.0:
        m[MODE] = STANDBY  # no pulse at all: the bridge stays open
    if m[FLOW] == CEASING:
        m[FLOW] = 1


@part
def latch(y, r, m, queue, p, on, mode, duty):  # type: ignore[no-untyped-def]
    """A command leaves the timer: it acts now, or after the delay on its way."""
    if p[DELAY] > 0.0:
        if m[WAITING] >= QUEUE - 1:
            return  # cannot be: the longest delay is shorter than the queue
        place = (m[HEAD] + m[WAITING]) % QUEUE
        queue[0, place] = r[TIME] + p[DELAY]
        queue[1, place] = duty
        queue[2, place] = mode
        m[WAITING] += 1
    else:
        act(y, r, m, p, on, mode, duty)


@part
def pass_time(y, r, m, queue, w, p, on, end):  # type: ignore[no-untyped-def]
    """Run to the time ``end`` under the commands latched so far."""
    while r[TIME] < end:
        while m[WAITING] > 0 and queue[0, m[HEAD]] <= r[TIME]:
            act(y, r, m, p, on, int(queue[2, m[HEAD]]), queue[1, m[HEAD]])
            m[HEAD] = (m[HEAD] + 1) % QUEUE
            m[WAITING] -= 1
        until = end
        if m[WAITING] > 0:
            until = min(until, queue[0, m[HEAD]])
        if r[TIME] < p[CHANGE_AT]:
            until = min(until, p[CHANGE_AT])
        p[CHANGED] = 1.0 if r[TIME] >= p[CHANGE_AT] else 0.0
        if m[PHASE] != MEAN:
            run_edges(y, r, m, w, until, p, on)
        else:
            settle(r[TIME], y, m, r[DUTY], p, on)
            run_until(y, r, m, w, until, p, on)


@entry
def run(y, r, m, queue, w, p, on, modes, duties, span, parts, counts, states):  # type: ignore[no-untyped-def]
    """Task steps of ``span`` seconds in a row; ``counts[k]`` and ``states[k]`` are the counter and the state before
    step k.

    A command is latched at the start of its step, none where its mode is ``NO_COMMAND``. Where looks at the encoder are
    kept, as :func:`firmware_model.encoder.read_encoder` says, there is one at the start and at the end of each of the
    ``parts`` parts of a step. All motion is in this one function: each that is called from Python is compiled with a
    copy of all that it calls.
    """
    for k in range(duties.shape[0]):
        counts[k] = m[COUNT]
        for i in range(states.shape[1]):
            states[k, i] = y[i]
        begin = r[TIME]
        if m[LOOKS] >= 0:
            read_encoder(y, r, m, p, on)
        if modes[k] != NO_COMMAND:
            latch(y, r, m, queue, p, on, modes[k], duties[k])
        for i in range(parts):
            pass_time(y, r, m, queue, w, p, on, begin + span * ((i + 1) / parts))


@entry
def meters(y, r, m, queue, w, p, on):  # type: ignore[no-untyped-def]
    """Mean current and mean voltage of the winding now; with the bridge open and no current, the back-emf."""
    current, rate = electrical(r[TIME], y, m, r[DUTY], p, on)
    return current, p[R] * current + p[L] * rate + p[KE] * y[OMEGA]
