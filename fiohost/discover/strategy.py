"""Which searches follow upon each other: by whole runs, by windows, begun anew, by the noise that is left."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fiohost.discover.clock import by_one_clock
from fiohost.discover.counts import AT_SPEED, COUNT_NOISE, LEAST_MOVING, ROUGHEST_COUNTS, counts_of, roughness, spread
from fiohost.discover.likelihood import Selection, select_by_deviance
from fiohost.discover.metrics import pool
from fiohost.discover.reconsider import reconsidered
from fiohost.discover.round import Progress
from fiohost.discover.search import SHOWS, Search, declared_alone, eased, only_commonest, select
from fiohost.discover.step import Found
from fiohost.estimation.record import Record
from fiohost.motor.effect import effects
from fiohost.motor.model import Model

# One search is preferred to another where it comes so much closer.
BETTER = 0.97
# Windows are looked at where so much of their power stands above the floor, as a share of it.
FAR_FROM_FLOOR = 3.0
# What is left is more than counts where windows stand above their error by this factor: the faintest worlds have 1.6.
MORE_THAN_COUNTS = 1.3
# Bootstrap samples of the noise have a stream of their own, so that no other draw depends on whether they are needed.
NOISE_SEED = 1


def searched(
    train: Sequence[Record],
    model: Model,
    library: Sequence[str] | None,
    from_file: bool,
    rng: np.random.Generator,
    say: Progress,
    hidden: Mapping[str, str],
) -> Found:
    """The search by whole runs, where counts are all that is left of a true model; where these stay unexplained, by
    windows, and by whole runs again from there; where that does not explain all either, or the sensor is noisy or
    commands are missing, by the deviance of windows under the noise that is left, without what is ``hidden`` from the
    logs.

    Names from windows as they are count only once whole runs can be followed with them: such windows also like what
    just lets a shaft coast whose speed wanders. With few experiments they come first: their whole runs have too many
    local minima. What was named in turn is asked for again in the end.
    """
    whole = Search(train, rng, library, say)
    alone = declared_alone(whole, model, from_file)
    if alone.final.follows:
        return alone

    def by_noise() -> Found:
        say("by the noise that is left")
        shown = [n for n in (effects() if library is None else library) if n not in hidden]
        return select_by_deviance(Selection(train, np.random.default_rng(NOISE_SEED), shown, say), alone.final.fit)

    if any(r.broken for r in train) or _noisy_sensor(train):
        return by_noise()
    found = reconsidered(whole, _by_turns(whole, model, from_file, alone))
    if found.final.follows:
        return found
    noisy = by_noise()
    return noisy if _explained_by_noise(noisy, max(r.quantum for r in train)) else found


def _noisy_sensor(records: Sequence[Record]) -> bool:
    """Whether readings of a moving shaft are rougher than any counts make them; of a sensor without counts nothing else
    is known.
    """
    if max(r.quantum for r in records) <= 0.0:
        return True
    found = [roughness(data) for data in map(counts_of, records) if data is not None]
    rough = np.concatenate([[], *(r[np.abs(speed) > AT_SPEED] for r, speed in found)])
    return len(rough) >= LEAST_MOVING and spread(rough) > ROUGHEST_COUNTS


def _explained_by_noise(found: Found, quantum: float) -> bool:
    """Whether what is left looks like noise that is more than counts."""
    final = found.final
    left, counts = _window_rms(found), quantum * COUNT_NOISE
    return found.white and final.follows and left > MORE_THAN_COUNTS * counts


def _by_turns(whole: Search, model: Model, from_file: bool, alone: Found) -> Found:
    train, few = whole.train, whole.context.few
    library, rng, say = whole.context.library, whole.context.rng, whole.context.say

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
