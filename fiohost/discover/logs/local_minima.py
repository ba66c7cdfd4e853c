"""Fits got out of a local minimum: begun again around where they stand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.discover.logs.optimise import again, cost_of
from fiohost.discover.settings import SETTINGS
from fiohost.estimation.fit import Fit
from fiohost.estimation.intervals import covariance
from fiohost.estimation.record import Record
from fiohost.motor.model import Model
from fiohost.workers import each

OPTIMISER = SETTINGS.optimiser


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
