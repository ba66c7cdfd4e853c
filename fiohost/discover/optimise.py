"""Refitting a candidate: from rough to its minimum, along ragged parameters, through other choices, off ledges."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from fiohost.discover.folds import beginning
from fiohost.discover.screen import Score, Trial, varied
from fiohost.discover.settings import SETTINGS
from fiohost.estimation.fit import Fit, first_guess, fit, unchanged
from fiohost.estimation.initial import guessed_warmth, has_own_warmth
from fiohost.estimation.intervals import covariance
from fiohost.estimation.predict import Flat, errors, squared, windowed
from fiohost.estimation.record import Record
from fiohost.estimation.tangent import Tangent
from fiohost.motor.effect import Effect, Parameter, effect
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


def cost_of(found: Fit, model: Model, records: Sequence[Record], lash: bool = False) -> float:
    """Squared error of a model as it is, in what another was fitted to; the motor where that has it in its gap unless
    ``lash`` is to be taken up anew.
    """
    windows, starts = found.windows, found.starts
    tolerance = OPTIMISER.near_enough if windows else 1e-7
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


def thorough_fit(direct: Fit, effect: Effect, records: Sequence[Record], far_rms: float = np.inf) -> Fit:
    """A fit at its minimum searched along the effect's ragged parameters and through its choices too; what stays
    beyond ``far_rms`` is not searched finely.
    """
    if direct.windows and effect.once:
        return direct  # its moment and what changed were looked for in all windows
    best = _from_rest(_thoroughly(direct, effect, records, far_rms), records)
    others = [_chosen_otherwise(best, effect, p, c, records) for p in effect.parameters for c in p.choices]
    near = [f for f in others if f is not best and f.cost < OPTIMISER.another_choice * best.cost]
    return min((best, *(_thoroughly(f, effect, records, far_rms) for f in near)), key=lambda f: f.cost)


def _from_rest(found: Fit, records: Sequence[Record]) -> Fit:
    """A fit of whole runs begun again with the load at rest around the motor: what suits the beginnings of the runs
    at a wrong gap can hold that gap fast.
    """
    if found.windows or not Flat.of(found.model).gap:
        return found
    resting = [s._replace(play=0.0, drift=0.0) for s in found.starts]
    other = fit(found.model, records, starts=resting, max_iterations=25, tolerance=1e-6)
    return min(found, other, key=lambda f: f.cost)


def finished(found: Fit, records: Sequence[Record]) -> Fit:
    """A fit of windows carried to its minimum."""
    return min(found, again(found, found.model, records, 25, 1e-6), key=lambda f: f.cost)


def _thoroughly(best: Fit, effect: Effect, records: Sequence[Record], far_rms: float) -> Fit:
    """A fit with its effect's ragged parameters searched, coarse, fine, and on while it pays; windows show no more than
    the coarse, nor do whole runs that stay beyond ``far_rms``.
    """
    for parameter in effect.parameters:
        if not parameter.ragged:
            continue
        key, was = f"{effect.name}.{parameter.name}", np.inf
        if best.windows:
            best = _searched(best, key, records, (OPTIMISER.coarse, OPTIMISER.fine))
            continue
        best = _searched(best, key, records, (OPTIMISER.coarse,))
        if best.rms > far_rms:
            continue
        best = _searched(best, key, records, (OPTIMISER.fine, OPTIMISER.finest))
        for _ in range(OPTIMISER.searched_again):
            if best.cost > OPTIMISER.still_better * was:
                break
            was, best = best.cost, _searched(best, key, records, (OPTIMISER.fine, OPTIMISER.finest))
    return best


def _chosen_otherwise(found: Fit, effect: Effect, parameter: Parameter, choice: str, records: Sequence[Record]) -> Fit:
    """A fit with one choice made otherwise, from the size that suits it best; itself where it was made so.

    A moment is found by any of the things that may have changed at it, and the wrong one can be ahead.
    """
    key = f"{effect.name}.{parameter.name}"
    if found.model.values[key] == choice:
        return found
    changed, models = found.model.with_values({key: choice}), []
    for size in (p for p in effect.parameters if p.neutral is not None and p.is_smooth):
        name, neutral = f"{effect.name}.{size.name}", float(size.neutral or 0.0)
        grown = [neutral + k * (found.model.number(name) - neutral) for k in OPTIMISER.choice_sizes]
        models += [changed.with_values({name: v}) for v in grown if size.lower <= v <= size.upper]
    costs = [cost_of(found, m, records, lash=True) for m in models]
    if not models:
        return found
    return again(found, models[int(np.argmin(costs))], records, 12, 1e-4)


def chosen_again(found: Fit, records: Sequence[Record], names: Sequence[str] | None = None) -> Fit:
    """A model with each of the choices of its effects, or of those ``names``, made as suits these records best."""
    for of in map(effect, found.model.effects if names is None else names):
        others = [_chosen_otherwise(found, of, p, choice, records) for p in of.parameters for choice in p.choices]
        found = min((found, *others), key=lambda f: f.cost)
    return found


def searched_again(found: Fit, records: Sequence[Record]) -> Fit:
    """A model with its ragged parameters searched once more: what was added since may have moved them."""
    for _ in range(OPTIMISER.searched_again):
        was = found.cost
        for key in found.names:
            if found.model.parameter(key).ragged:
                found = _searched(found, key, records, (OPTIMISER.fine, OPTIMISER.finest))
        if found.cost > OPTIMISER.still_better * was:
            break
    return found


def _searched(found: Fit, key: str, records: Sequence[Record], scales: Sequence[tuple[float, float, int]]) -> Fit:
    """The best of fits from points along one parameter, coarse then fine, the others fitted anew from the best
    points.
    """
    parameter = found.model.parameter(key)
    for scale in scales:
        factors = np.geomspace(*scale)
        centre = found.model.number(key)
        points = [centre * f if parameter.neutral == 0.0 else centre + OPTIMISER.moment_s * np.log(f) for f in factors]
        models = [found.model.with_values({key: float(np.clip(x, parameter.lower, parameter.upper))}) for x in points]
        costs = [cost_of(found, m, records) for m in models]
        near = [models[i] for i in np.argsort(costs)[:2]]
        fits = [again(found, m, records, 12, OPTIMISER.near_enough if found.windows else 1e-5) for m in near]
        found = min((found, *fits), key=lambda f: f.cost)
    return _centred(found, key, records)


def _centred(found: Fit, key: str, records: Sequence[Record]) -> Fit:
    """The middle of where the data cannot tell one value of a parameter from the next.

    Whether a shaft starts or not is all that is known of a threshold: between two commands any level does.
    """
    parameter, centre = found.model.parameter(key), found.model.number(key)

    def same(value: float) -> bool:
        inside = parameter.lower <= value <= parameter.upper
        moved = found.model.with_values({key: value}) if inside else found.model
        return inside and cost_of(found, moved, records) <= found.cost * (1.0 + OPTIMISER.flat)

    def edge(way: float) -> float:
        near, step = centre, way * max(abs(centre), 1e-3) * OPTIMISER.first_step
        for _ in range(OPTIMISER.doublings):
            if not same(near + step):
                break
            near, step = near + step, 2.0 * step
        for _ in range(OPTIMISER.halvings):
            step *= 0.5
            near = near + step if same(near + step) else near
        return near

    middle = 0.5 * (edge(-1.0) + edge(1.0))
    if middle == centre:
        return found
    moved = again(found, found.model.with_values({key: middle}), records, 2, 1e-7)
    return moved if moved.cost <= found.cost * (1.0 + OPTIMISER.flat) else found


def polish(found: Fit, records: Sequence[Record], rng: np.random.Generator) -> Fit:
    """The best of fits started around a fitted model, within what its parameters are uncertain by, taken together.

    Stick makes the cost rugged at small scale: whether a shaft rests or just starts is decided by the last digits,
    and a fit may stand on a ledge beside the minimum. Many points are looked at, the best few are fitted again.
    """
    cov, _ = covariance(found)
    seen = np.isfinite(np.diag(cov)) & (np.diag(cov) > 0)
    if not seen.any():
        return found
    names = [n for n, s in zip(found.names, seen, strict=True) if s]
    parameters = [found.model.parameter(n) for n in names]
    values, vectors = np.linalg.eigh(cov[np.ix_(seen, seen)])
    spread = vectors * np.sqrt(np.maximum(values, 0.0))
    centre = np.array([found.model.number(n) for n in names])

    def moved(draw: int) -> Model:
        point = centre + (0.5 + 3.0 * draw / OPTIMISER.looks) * spread @ rng.standard_normal(len(names))
        inside = [float(np.clip(v, q.lower, q.upper)) for v, q in zip(point, parameters, strict=True)]
        return found.model.with_values(dict(zip(names, inside, strict=True)))

    def cost(model: Model) -> float:
        return cost_of(found, model, records)

    looked = [moved(draw) for draw in range(OPTIMISER.looks)]
    costs = each(cost, looked)
    best = [looked[i] for i in np.argsort(costs)[: OPTIMISER.nudges]]
    better = min(each(lambda m: again(found, m, records, 12, 1e-7), best), key=lambda f: f.cost)
    return better if better.cost < found.cost * (1.0 - OPTIMISER.paid) else found


def unstuck(found: Fit, records: Sequence[Record], rng: np.random.Generator) -> Fit:
    """A fit begun again around each of its parameters in turn, farther than it believes them uncertain, and polished.

    Beside ledges the covariance says nothing of how far off a parameter is: a few logs, mostly at rest, are followed
    closely by friction and gain that are off by percents together.
    """
    for _ in range(OPTIMISER.begun_again):
        was = found.cost
        for name in found.names:
            found = _begun_around(found, name, records)
        found = polish(found, records, rng)
        if found.cost > OPTIMISER.still_better * was:
            break
    return found


def _begun_around(found: Fit, name: str, records: Sequence[Record]) -> Fit:
    """The best of fits begun with one parameter moved: a few steps from each, the best few carried on."""
    parameter, value = found.model.parameter(name), found.model.number(name)
    points = [float(np.clip(k * value, parameter.lower, parameter.upper)) for k in OPTIMISER.around]
    models = [found.model.with_values({name: v}) for v in dict.fromkeys(points)]
    rough = sorted(each(lambda m: again(found, m, records, 2, 1e-2), models), key=lambda f: f.cost)
    near = each(lambda f: again(f, f.model, records, 4, 1e-2), rough[: OPTIMISER.nudges])
    best = min(near, key=lambda f: f.cost)
    return min(found, again(best, best.model, records, 25, 1e-7), key=lambda f: f.cost)
