"""Refitting a candidate: from rough to its minimum, along ragged parameters, through other choices, off ledges."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from fiohost.discover.logs.folds import beginning
from fiohost.discover.logs.scores import Score
from fiohost.discover.settings import SETTINGS
from fiohost.discover.trials import Trial, varied
from fiohost.estimation.fit import Fit, first_guess, fit, unchanged
from fiohost.estimation.initial import guessed_warmth, has_own_warmth
from fiohost.estimation.predict import Flat, errors, squared, windowed
from fiohost.estimation.record import Record
from fiohost.estimation.tangent import Tangent
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.workers import each

# A tolerance within which no step is worth taking.
ENDLESS = 1e30

OPTIMISER = SETTINGS.optimiser


def _plain_costs(base: Fit, models: Sequence[Model], records: Sequence[Record]) -> list[float]:
    """Squared errors of models with the same effects, begun as a fit's, offsets of whole runs apart, windows along the
    fit's tangent; how warm a record was is guessed by the first of them.
    """
    if not models:
        return []
    flat, starts = Flat.of(base.model), _starts(base, models[0], records)
    near = [windowed(r, flat, s) for r, s in zip(records, base.starts, strict=True)] if base.windows else []
    tangents = [Tangent(r, flat, s, begun) for r, s, (_, begun) in zip(records, base.starts, near, strict=bool(near))]

    def left(i: int, other: Flat) -> np.ndarray:
        if base.windows:
            return np.asarray(near[i][0] - tangents[i].by(other, starts[i], 1.0))
        record, error = records[i], errors(records[i], other, starts[i])
        return np.asarray(
            error - record.weights * float(error @ record.weights) / float(record.weights @ record.weights)
        )

    return [squared(map(partial(left, other=Flat.of(m)), range(len(records)))) for m in models]


def _starts(found: Fit, model: Model, records: Sequence[Record]) -> list[Start]:
    """Starts for a model from those of another's fit: how warm it was, a model that does not warm says nothing of."""
    flat = Flat.of(model)
    if not flat.warms or Flat.of(found.model).warms:
        return list(found.starts)
    return [
        s._replace(warmth=guessed_warmth(r, flat.from_zero(s.zero), s, r.y)) if has_own_warmth(r, flat) else s
        for r, s in zip(records, found.starts, strict=True)
    ]


def again(
    found: Fit, model: Model, records: Sequence[Record], max_iterations: int = 40, tolerance: float = 1e-7
) -> Fit:
    """A model fitted to what another was fitted to, from that one's starts."""
    other = set(Flat.of(model).orders()) - set(Flat.of(found.model).orders())
    return fit(
        model,
        records,
        windows=found.windows,
        starts=_starts(found, model, records),
        max_iterations=max_iterations,
        tolerance=tolerance,
        zeros=bool(other),  # an order that is new may have left the logs' own zeros open
    )


def as_it_is(found: Fit, model: Model, records: Sequence[Record]) -> Fit:
    """A model with its derivatives where it stands, on what another was fitted to and from its starts: no step pays."""
    return again(found, model, records, 1, tolerance=ENDLESS)


def cost_of(found: Fit, model: Model, records: Sequence[Record], lash: bool = False, nearly: bool = False) -> float:
    """Squared error of a model as it is, in what another was fitted to; the motor where that has it in its gap unless
    ``lash`` is to be taken up anew. ``nearly`` is enough to say which of several leaves least.
    """
    windows, starts = found.windows, found.starts
    tolerance = OPTIMISER.near_enough if windows or nearly else 1e-7
    return unchanged(model, records, starts=starts, windows=windows, lash=lash, zeros=False, tolerance=tolerance).cost


def begun(base: Fit, score: Score, records: Sequence[Record]) -> list[Fit]:
    """The base model with one effect added, one step from each of its best beginnings, all of which are to go on: the
    first step does not tell which of two resonances is right. Windows are nearly convex: there the best is enough.
    """
    fits = [again(base, m, records, 1, 1e-2) for m in _beginnings(base, score, records)]
    return sorted(fits, key=lambda f: f.cost)[: 1 if base.windows else None]


def nearest_of(base: Fit, models: Sequence[Model], records: Sequence[Record]) -> tuple[float, Model]:
    """Of several models that which as it is leaves the least squared error, and that error."""
    costs = _plain_costs(base, models, records)
    least = int(np.argmin(costs))
    return costs[least], models[least]


def gone_on(ahead: Sequence[Fit], records: Sequence[Record]) -> Fit:
    """The best of fits that were begun, after a few more steps of each."""
    return min((*ahead, *(_on(f, records, 4) for f in ahead)), key=lambda f: f.cost)


def _beginnings(base: Fit, score: Score, records: Sequence[Record]) -> list[Model]:
    """The base model with an effect at those trials that leave least, each with the model's own parameters as they are
    or as least squares have them beside it; of what swings at all that score well, as no gradient leads from one order
    to the next. In windows, which are nearly convex, scores say what is left.
    """
    others = (t for t in score.raw if t not in score.trials and t not in score.far)
    of, trials = score.effect, [*score.trials, *others]
    owns: list[Trial] = [*score.own, *({} for _ in trials[len(score.own) :])]

    def model(i: int, own: Trial) -> Model:
        added = base.model.with_effect(of.name, trials[i])
        return added.with_values({n: v for n, v in own.items() if n in added.values})

    if base.windows:
        best_first = dict.fromkeys((0, *(trials.index(t) for t in score.raw[:1] if t in trials), *range(len(trials))))
        return [model(i, {}) for i in best_first if i < len(trials)][: OPTIMISER.window_starts]
    ways = [[model(i, own) for own in ({}, owns[i])[: 1 + bool(owns[i])]] for i in range(len(trials))]
    left = iter(_plain_costs(base, [m for models in ways for m in models], records))
    costs = [[next(left) for _ in models] for models in ways]
    order = varied(of, trials, sorted(range(len(trials)), key=lambda i: min(costs[i])))
    most = max(OPTIMISER.starts, len(score.trials)) if of.couples or of.points else OPTIMISER.starts
    # Where there are few trials, both ways: the one that leaves less at first may lead to another minimum.
    found = [ways[i][int(np.argmin(costs[i]))] for i in order] + [ways[i][int(np.argmax(costs[i]))] for i in order]
    return list({id(m): m for m in found}.values())[:most]


def fits_anew(base: Fit, scores: Sequence[Score], records: Sequence[Record], most: int) -> list[tuple[int, Fit]]:
    """The base model with each of several effects, but not from the base's values: those of a model that fits nothing
    lead nowhere. All are fitted to windows of a part of the ``records``; the ``most`` that leave least there to all
    records, in windows or whole as the base is; with their places among the ``scores``.
    """
    share = max(OPTIMISER.anew_s / len(records), OPTIMISER.anew_least_s)
    parts = [beginning(r, share) for r in records]
    first, then, last = OPTIMISER.anew_steps

    def in_windows(score: Score) -> Fit:
        trials = score.trials[:1]
        if score.raw:
            added = [base.model.with_effect(score.effect.name, t) for t in score.raw]
            least = np.argsort(_plain_costs(base, added, records))
            trials = tuple(score.raw[i] for i in least[: OPTIMISER.anew_starts])
        guesses = [first_guess(base.model.with_effect(score.effect.name, t), records) for t in trials]
        guesses = [g.with_values({"linear.tau_s": OPTIMISER.anew_lag_s}) for g in guesses]
        near = (fit(g, parts, windows=True, max_iterations=first, tolerance=1e-2) for g in guesses)
        return min(near, key=lambda f: f.cost)

    near = each(in_windows, scores)
    best = list(range(len(near)))
    # Successive halving (Karnin, Koren and Somekh 2013): those that leave most are not carried further.
    for kept, steps in ((2 * most, then), (most, last)):
        best = sorted(best, key=lambda i: near[i].cost)[:kept]
        carried = each(partial(_on, records=parts, steps=steps), [near[i] for i in best])
        for i, found in zip(best, carried, strict=True):
            near[i] = found

    def on_all(i: int) -> Fit:
        return fit(near[i].model, records, windows=base.windows, max_iterations=8, tolerance=1e-3)

    return list(zip(best, each(on_all, best), strict=True))


def _on(found: Fit, records: Sequence[Record], steps: int) -> Fit:
    """A fit after a few more steps."""
    return again(found, found.model, records, steps, 1e-2)


def carried_on(rough: Fit, records: Sequence[Record]) -> Fit:
    """A rough fit carried downhill to its minimum; of windows, as near to it as their tangent leads (``finished``)."""
    return again(rough, rough.model, records, 25, OPTIMISER.near_enough if rough.windows else 1e-6)


def finished(found: Fit, records: Sequence[Record]) -> Fit:
    """A fit of windows carried to its minimum."""
    return min(found, again(found, found.model, records, 25, 1e-6), key=lambda f: f.cost)
