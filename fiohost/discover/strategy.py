"""Which searches follow upon each other: by whole runs, by one-second windows, by whole runs again, begun anew."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.discover.clock import by_one_clock
from fiohost.discover.metrics import pool
from fiohost.discover.reconsider import reconsidered
from fiohost.discover.round import Progress
from fiohost.discover.search import SHOWS, Search, declared_alone, eased, only_commonest, select
from fiohost.discover.step import Found
from fiohost.estimation.record import Record
from fiohost.motor.model import Model

# One search is preferred to another where it comes so much closer.
BETTER = 0.97
# Windows are looked at where so much of their power stands above the floor, as a share of it.
FAR_FROM_FLOOR = 3.0


def searched(
    train: Sequence[Record],
    model: Model,
    library: Sequence[str] | None,
    from_file: bool,
    rng: np.random.Generator,
    say: Progress,
) -> Found:
    """The search by whole runs; where these stay unexplained, by windows, and by whole runs again from there.

    Names from windows count only once whole runs can be followed with them: windows alone also like what just lets a
    shaft coast whose speed wanders. With few experiments they come first: their whole runs have too many ledges. What
    was named in turn is asked for again in the end.
    """
    whole = Search(train, rng, library, say)
    return reconsidered(whole, _by_turns(whole, model, from_file))


def _by_turns(whole: Search, model: Model, from_file: bool) -> Found:
    train, few = whole.train, whole.context.few
    library, rng, say = whole.context.library, whole.context.rng, whole.context.say
    alone = declared_alone(whole, model, from_file)
    if alone.final.follows:
        return alone

    def by_windows() -> Found:
        found = select(Search(train, rng, library, say, windows=True), alone)
        if not found.steps or found.final.fit.windows:
            return found
        return select(whole, eased(whole, found) if few else found)

    seen = None
    if few:
        say("few experiments: looking at windows of 1 s first")
        seen = by_windows()
        if seen.steps and (seen.final.follows or seen.final.windows_above_floor < SHOWS):
            return seen
    found = select(whole, alone)
    if found.final.follows:
        return found
    if timed := by_one_clock(whole, model, from_file):
        return timed
    if not few and _may_show_in_windows(found):
        say("whole runs stay unexplained: looking at windows of 1 s")
        seen = by_windows()
    if seen and seen.steps and not seen.final.fit.windows and _window_rms(seen) < BETTER * _window_rms(found):
        found = seen
    if not found.final.follows and found.final.lost:
        say("still far from the floor: beginning anew with each effect")
        other = select(Search(train, rng, library, say, anew=True), alone)
        found = other if other.final.fit.rms < BETTER * found.final.fit.rms else found
    return only_commonest(whole, found) if found.steps and found.final.utterly_lost else found


def _may_show_in_windows(found: Found) -> bool:
    """Whether windows may tell what whole free runs do not, which slow disturbances rule."""
    left = found.final.windows_above_floor
    return left > FAR_FROM_FLOOR or (found.final.lost and left > SHOWS)


def _window_rms(found: Found) -> float:
    errors = pool([j.errors for j in found.final.judgements])
    return errors.window_rms if errors else 0.0
