"""Thresholds, gaps and choices: searched along their axes, coarse to fine, and tried."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.discover.logs.optimise import again, cost_of
from fiohost.discover.settings import SETTINGS
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.predict import Flat
from fiohost.estimation.record import Record
from fiohost.motor.effect import Effect, Parameter, effect

OPTIMISER = SETTINGS.optimiser


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
    costs = [cost_of(found, m, records, lash=True, nearly=True) for m in models]
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
        costs = [cost_of(found, m, records, nearly=True) for m in models]
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
