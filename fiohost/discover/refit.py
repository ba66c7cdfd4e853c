"""Refitting a candidate: from rough to its minimum, along ragged parameters, through other choices, off ledges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.discover.choose import slices
from fiohost.discover.screen import Score, Trial
from fiohost.discover.workers import each
from fiohost.estimation.fit import Fit, first_guess, fit, unchanged
from fiohost.estimation.intervals import covariance
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import Record
from fiohost.motor.effect import Effect, Parameter
from fiohost.motor.model import Model

STARTS, RAW_STARTS = 4, 2
ANEW_STARTS = 2
ANEW_S, ANEW_LEAST_S = 60.0, 4.0  # of all logs together, of each log
ANEW_LAG_S = 0.1
# Where to look along a ragged parameter, as factors on its value; a moment is moved by their logarithms times MOMENT_S.
COARSE = np.geomspace(0.2, 5.0, 20)
FINE = np.geomspace(0.85, 1.18, 16)
FINEST = np.geomspace(0.98, 1.02, 16)
MOMENT_S = 2.0
# The fine search goes on from where it came to while it pays.
SEARCHED_AGAIN, STILL_BETTER = 3, 0.99
# Another choice is searched where it comes this close, from these multiples of the size.
ANOTHER_CHOICE, CHOICE_SIZES = 2.0, (1.0, -1.0, 0.5, -0.5, 2.0, -2.0)
# Squared errors this close cannot tell two values of a threshold; how the ends of such a range are felt for.
FLAT, FIRST_STEP, DOUBLINGS, HALVINGS = 1e-4, 1e-3, 10, 5
LOOKS, NUDGES = 48, 4


def _plain_cost(base: Fit, effect: Effect, trial: Trial, records: Sequence[Record]) -> float:
    """Squared error of a free run with an effect at a trial size, offsets apart."""
    flat = Flat.of(base.model.with_effect(effect.name, trial))
    total = 0.0
    for record, start in zip(records, base.starts, strict=True):
        weights, error = record.weights**2, record.y - free_output(record, flat, start)
        total += float(weights @ (error - np.average(error, weights=weights)) ** 2)
    return total


def rough_fit(base: Fit, score: Score, records: Sequence[Record]) -> Fit:
    """The base model with one effect added: the best of a few steps from each of its best trials."""
    trials = [*score.trials[:STARTS]]
    looked = {i: _plain_cost(base, score.effect, t, records) for i, t in enumerate(score.raw) if t not in trials}
    trials += [score.raw[i] for i in sorted(looked, key=lambda i: looked[i])[:RAW_STARTS]]
    starts = [base.model.with_effect(score.effect.name, trial) for trial in trials]
    rough = [fit(m, records, starts=base.starts, max_iterations=5, tolerance=1e-2) for m in starts]
    return min(rough, key=lambda f: f.cost)


def fit_anew(base: Fit, score: Score, records: Sequence[Record]) -> Fit:
    """As ``rough_fit``, but not from the base's values: those of a model that fits nothing lead nowhere."""

    share = max(ANEW_S / len(records), ANEW_LEAST_S)
    parts = [slices(r, max(1, int(r.seconds / share)))[0] for r in records]

    def attempt(trial: Trial) -> Fit:
        guess = first_guess(base.model.with_effect(score.effect.name, trial), records)
        guess = guess.with_values({"linear.tau_s": ANEW_LAG_S})
        near = fit(guess, parts, windows=True, max_iterations=12, tolerance=1e-2)
        return fit(near.model, records, max_iterations=8, tolerance=1e-3)

    trials = score.trials[:1]
    if score.raw:
        trials = tuple(sorted(score.raw, key=lambda t: _plain_cost(base, score.effect, t, records))[:ANEW_STARTS])
    return min((attempt(t) for t in trials), key=lambda f: f.cost)


def full_fit(
    rough: Fit,
    effect: Effect,
    records: Sequence[Record],
    *,
    search: bool = True,
    lost_rms: float = np.inf,
    trials: Sequence[Model] = (),
) -> Fit:
    """A rough fit carried to its minimum; ``search`` also looks along the effect's ragged parameters.

    Where whole runs stay above ``lost_rms`` and the effect has a ragged parameter, one-second windows are fitted first,
    from ``trials`` too: a shaft that starts a moment too late misses by the whole motion, which leads gradients astray.
    """
    direct = fit(rough.model, records, starts=rough.starts, max_iterations=25, tolerance=1e-6)
    if direct.rms > lost_rms and any(q.ragged for q in effect.parameters):
        by_windows = [fit(m, records, windows=True, max_iterations=12, tolerance=1e-3) for m in (rough.model, *trials)]
        best_windows = min(by_windows, key=lambda f: f.cost)
        whole = fit(best_windows.model, records, max_iterations=25, tolerance=1e-6)
        direct = min(direct, whole, key=lambda f: f.cost)
    best = _thoroughly(direct, effect, records, search)
    others = [_chosen_otherwise(best, effect, p, c, records) for p in effect.parameters if search for c in p.choices]
    near = [f for f in others if f is not best and f.cost < ANOTHER_CHOICE * best.cost]
    return min((best, *(_thoroughly(f, effect, records, search) for f in near)), key=lambda f: f.cost)


def _thoroughly(best: Fit, effect: Effect, records: Sequence[Record], search: bool) -> Fit:
    """A fit with its effect's ragged parameters searched, coarse, fine, and on while it pays."""
    for parameter in effect.parameters:
        if not (parameter.ragged and search):
            continue
        key, was = f"{effect.name}.{parameter.name}", np.inf
        best = _searched(best, key, records, (COARSE, FINE, FINEST))
        for _ in range(SEARCHED_AGAIN):
            if best.cost > STILL_BETTER * was:
                break
            was, best = best.cost, _searched(best, key, records, (FINE, FINEST))
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
        grown = [neutral + k * (found.model.number(name) - neutral) for k in CHOICE_SIZES]
        models += [changed.with_values({name: v}) for v in grown if size.lower <= v <= size.upper]
    costs = [unchanged(m, records, starts=found.starts).cost for m in models]
    if not models:
        return found
    return fit(models[int(np.argmin(costs))], records, starts=found.starts, max_iterations=12, tolerance=1e-4)


def searched_again(found: Fit, records: Sequence[Record]) -> Fit:
    """A model with its ragged parameters searched once more: what was added since may have moved them."""
    for _ in range(SEARCHED_AGAIN):
        was = found.cost
        for key in found.names:
            if found.model.parameter(key).ragged:
                found = _searched(found, key, records, (FINE, FINEST))
        if found.cost > STILL_BETTER * was:
            break
    return found


def _searched(found: Fit, key: str, records: Sequence[Record], scales: Sequence[np.ndarray]) -> Fit:
    """The best of fits from points along one parameter, coarse then fine, the others fitted anew from the best
    points.
    """
    parameter = found.model.parameter(key)
    for factors in scales:
        centre = found.model.number(key)
        points = [centre * f if parameter.neutral == 0.0 else centre + MOMENT_S * np.log(f) for f in factors]
        models = [found.model.with_values({key: float(np.clip(x, parameter.lower, parameter.upper))}) for x in points]
        costs = [unchanged(m, records, starts=found.starts).cost for m in models]
        near = [models[i] for i in np.argsort(costs)[:2]]
        fits = [fit(m, records, starts=found.starts, max_iterations=12, tolerance=1e-5) for m in near]
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
        return inside and unchanged(moved, records, starts=found.starts).cost <= found.cost * (1.0 + FLAT)

    def edge(way: float) -> float:
        near, step = centre, way * max(abs(centre), 1e-3) * FIRST_STEP
        for _ in range(DOUBLINGS):
            if not same(near + step):
                break
            near, step = near + step, 2.0 * step
        for _ in range(HALVINGS):
            step *= 0.5
            near = near + step if same(near + step) else near
        return near

    middle = 0.5 * (edge(-1.0) + edge(1.0))
    if middle == centre:
        return found
    moved = fit(found.model.with_values({key: middle}), records, starts=found.starts, max_iterations=2)
    return moved if moved.cost <= found.cost * (1.0 + FLAT) else found


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
        point = centre + (0.5 + 3.0 * draw / LOOKS) * spread @ rng.standard_normal(len(names))
        inside = [float(np.clip(v, q.lower, q.upper)) for v, q in zip(point, parameters, strict=True)]
        return found.model.with_values(dict(zip(names, inside, strict=True)))

    def cost(model: Model) -> float:
        return unchanged(model, records, starts=found.starts).cost

    looked = [moved(draw) for draw in range(LOOKS)]
    costs = each(cost, looked)
    best = [looked[i] for i in np.argsort(costs)[:NUDGES]]
    nudged = each(lambda m: fit(m, records, starts=found.starts, max_iterations=12, tolerance=1e-7), best)
    return min((found, *nudged), key=lambda f: f.cost)
