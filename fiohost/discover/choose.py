"""Choosing among candidates: refits from several starts, cross-validation over the training records, ambiguity.

Cross-validation leaves out whole experiments (repeats of one experiment together), fits the rest and looks at the
free run of what was left out. Held-out records never come here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiohost.discover.floor import repeats
from fiohost.discover.screen import Score, Trial
from fiohost.discover.workers import each
from fiohost.estimation.fit import Fit, first_guess, fit, unchanged
from fiohost.estimation.intervals import covariance, estimates
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import Record, make_record
from fiohost.motor.effect import Effect, Parameter, Value
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
CLOSE = 1.03
STEP_SHARES = (1.0, 0.5, 0.25)
KNOWN_ANYWAY = 0.02
SIGMAS_FROM_NEUTRAL = 3.0
LEAST_CV_GAIN = 0.01
BLOCK_S = 2.0


def slices(record: Record, pieces: int) -> list[Record]:
    """A record cut into consecutive pieces, each with an initial state of its own."""
    edges = np.linspace(0, len(record), pieces + 1).astype(int)
    ex = record.excitation
    delay = float(ex.act_times_s[0] - ex.times_s[0])
    found = []
    for i, (a, b) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        piece = make_record(
            f"{record.name} [{i + 1}/{pieces}]",
            ex.times_s[a:b],
            ex.duties_pct[1:][a:b],
            record.y[a:b],
            mode=ex.modes[1:][a:b],
            kind=record.kind,
            unit=record.unit,
            quantum=record.quantum,
            sample_time_s=record.sample_time_s,
            command_delay_s=delay,
            rotary=record.rotary,
            clock_s=ex.clock_s + float(ex.times_s[a]),
            own_zero=record.own_zero,
        )
        if a > 0:
            duties = piece.excitation.duties_pct.copy()
            modes = piece.excitation.modes.copy()
            duties[0], modes[0] = ex.duties_pct[a], ex.modes[a]
            piece = replace(piece, at_rest=False, excitation=replace(piece.excitation, duties_pct=duties, modes=modes))
        found.append(piece)
    return found


def folds(records: Sequence[Record], horizon_s: float | None, most: int = 6) -> tuple[list[Record], list[list[int]]]:
    """The records to fit, and the groups of them to leave out in turn.

    With a horizon every record is cut into pieces of about that length. Groups are whole experiments, repeats together;
    where there are fewer than three, records are cut in time and the pieces are left out.
    """
    experiments = [*repeats(records)]
    grouped = {i for g in experiments for i in g}
    experiments.extend([i] for i in range(len(records)) if i not in grouped)

    def pieces_of(record: Record) -> int:
        return 1 if horizon_s is None else max(1, int(record.seconds / horizon_s))

    counts = [pieces_of(r) for r in records]
    if len(experiments) < 3:
        counts = [max(n, 2, min(4, int(r.seconds // 4))) for n, r in zip(counts, records, strict=True)]
    pieces: list[Record] = []
    where: list[list[int]] = []
    for record, count in zip(records, counts, strict=True):
        where.append(list(range(len(pieces), len(pieces) + count)))
        pieces.extend([record] if count == 1 else slices(record, count))
    if len(experiments) < 3:
        parts = [list(part) for w in where for part in np.array_split(np.array(w), min(4, len(w)))]
        groups = [[int(i) for i in part] for part in parts]
    else:
        groups = [[j for i in g for j in where[i]] for g in experiments]
    while len(groups) > most:
        groups.sort(key=lambda g: sum(len(pieces[i]) for i in g))
        groups = [groups[0] + groups[1], *groups[2:]]
    return pieces, groups


@dataclass(frozen=True)
class Validated:
    """A fitted model and how it did on what it had not seen: squared errors (blocks) of every left-out record."""

    fit: Fit
    blocks: np.ndarray
    fold_costs: np.ndarray

    @property
    def cost(self) -> float:
        return float(self.blocks.sum())


def without_group(fitted: Fit, records: Sequence[Record], group: Sequence[int]) -> Model:
    """The model as it would be fitted without a group of its records: one Newton step from the whole fit, halved
    while it does not pay on the rest.

    A parameter of which the rest says next to nothing stays where the whole fit has it.
    """
    if not fitted.names:
        return fitted.model
    rest = [i for i in range(len(records)) if i not in group]
    hessian = sum(fitted.jacobians[i].T @ fitted.jacobians[i] for i in rest)
    gradient = sum(fitted.jacobians[i].T @ fitted.residuals[i] for i in rest)
    whole = hessian + sum(fitted.jacobians[i].T @ fitted.jacobians[i] for i in group)
    scale = np.sqrt(np.maximum(np.diag(whole), 1e-300))
    held = hessian / np.outer(scale, scale) + KNOWN_ANYWAY * np.eye(len(scale))
    step = np.linalg.solve(held, gradient / scale) / scale
    before = sum(float(fitted.residuals[i] @ fitted.residuals[i]) for i in rest)
    kept, starts = [records[i] for i in rest], [fitted.starts[i] for i in rest]
    for share in STEP_SHARES:
        values: dict[str, Value] = {}
        for name, change in zip(fitted.names, share * step, strict=True):
            parameter = fitted.model.parameter(name)
            values[name] = float(np.clip(fitted.model.number(name) + change, parameter.lower, parameter.upper))
        model = fitted.model.with_values(values)
        if unchanged(model, kept, starts=starts).cost <= before:
            return model
    return fitted.model


def validate(fitted: Fit, cv_records: Sequence[Record], groups: Sequence[Sequence[int]]) -> Validated:
    """Cross-validate the structure of a fitted model: what each group of records, left out, makes of the rest's fit."""
    blocks: list[float] = []
    costs: list[float] = []
    for group in groups:
        out = [cv_records[i] for i in group]
        seen = unchanged(without_group(fitted, cv_records, group), out, starts=[fitted.starts[i] for i in group])
        for record, residual in zip(out, seen.residuals, strict=True):
            size = max(1, round(BLOCK_S / record.sample_time_s))
            blocks.extend(float(residual[a : a + size] @ residual[a : a + size]) for a in range(0, len(residual), size))
        costs.append(seen.cost)
    return Validated(fitted, np.array(blocks), np.array(costs))


def _plain_cost(base: Fit, effect: Effect, trial: Trial, records: Sequence[Record]) -> float:
    """Squared error of a free run with an effect at a trial size, offsets apart."""
    flat = Flat.of(base.model.with_effect(effect.name, trial))
    residuals = [r.y - free_output(r, flat, s) for r, s in zip(records, base.starts, strict=True)]
    return float(sum(np.var(e) * len(e) for e in residuals))


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


def full_fit(rough: Fit, effect: Effect, records: Sequence[Record], *, search: bool = True) -> Fit:
    """A rough fit carried to its minimum; ``search`` also looks along the effect's ragged parameters."""
    best = _thoroughly(
        fit(rough.model, records, starts=rough.starts, max_iterations=25, tolerance=1e-6), effect, records, search
    )
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
    for key in found.names:
        if found.model.parameter(key).ragged:
            found = _searched(found, key, records, (FINE, FINEST))
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


def objection(found: Fit, name: str, replicas: Sequence[Model] = ()) -> str | None:
    """Why a fitted effect cannot be believed by its parameters alone, or None; replicas as for ``estimates``."""
    known = estimates(found, replicas)
    for parameter in found.model.parts()[-1].parameters:
        key = f"{name}.{parameter.name}"
        if not parameter.is_smooth or key not in known:
            continue
        value = known[key]
        if value.at_bound and (value.value != 0.0 or parameter.neutral is not None):
            # Nothing in nature is below zero; any other bound is one of the search.
            return f"{parameter.name} went to its bound {value.value:g} {parameter.unit}"
        if parameter.neutral is None or parameter.ragged:
            continue  # a ragged parameter has no width by gradients: the fit and the left-out records judge it
        if abs(value.value - parameter.neutral) < 1e-9:
            return f"{parameter.name} went to {parameter.neutral:g}, where the effect vanishes"
        if value.half_width / 1.96 * SIGMAS_FROM_NEUTRAL > abs(value.value - parameter.neutral):
            return f"{parameter.name} is not distinct from {parameter.neutral:g}, where the effect vanishes"
    return None


def indistinguishable(best: Validated, rival: Validated, base_cost: float) -> bool:
    """Whether a rival does as well as the best on left-out data, within what the data can tell."""
    if rival.cost <= best.cost * CLOSE**2:
        return True
    gain, rival_gain = base_cost - best.cost, base_cost - rival.cost
    if rival_gain < 0.8 * gain:
        return False
    difference = rival.blocks - best.blocks
    error = float(difference.std(ddof=1)) * np.sqrt(len(difference))
    return bool(difference.sum() < 2.0 * error)
