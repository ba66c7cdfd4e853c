"""Choosing among candidates: refits from several starts, cross-validation over the training records, ambiguity.

Cross-validation leaves out whole experiments (repeats of one experiment together), fits the rest and looks at the
free run of what was left out. Held-out records never come here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiohost.discover.floor import repeats
from fiohost.errors import DataError
from fiohost.estimation.fit import Fit, unchanged
from fiohost.estimation.intervals import Estimate, covariance, estimates
from fiohost.estimation.record import SHORTEST, Record, make_record
from fiohost.motor.effect import Parameter, Value
from fiohost.motor.model import Model

CLOSE = 1.03
# A rival has to gain this share of what the best does.
SHARED_GAIN = 0.8
STEP_SHARES = (1.0, 0.5, 0.25)
KNOWN_ANYWAY = 0.02
# Of a parameter that the others know by no more than this share of what one group does, they know nothing.
ELSEWHERE = 1e-3
SIGMAS_FROM_NEUTRAL = 3.0
BLOCK_S = 2.0
# Edges move by a quarter of a piece at most: so two pieces, and more of twice the shortest, are long enough.
SHORTEST_CUT = 3 * SHORTEST


def slices(record: Record, pieces: int) -> list[Record]:
    """A record cut into consecutive pieces, each with an initial state of its own."""
    ex = record.excitation
    edges = _quiet_edges(ex.duties_pct[1:], pieces)
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
            segments=record.segments[a:b],
        )
        if a > 0:
            duties = piece.excitation.duties_pct.copy()
            modes = piece.excitation.modes.copy()
            duties[0], modes[0] = ex.duties_pct[a], ex.modes[a]
            piece = replace(piece, at_rest=False, excitation=replace(piece.excitation, duties_pct=duties, modes=modes))
        found.append(piece)
    return found


def _quiet_edges(duties_pct: np.ndarray, pieces: int) -> list[int]:
    """Where commands (n) are cut into about equal pieces: each edge as far from any change of the command as it can be.

    Cut at a change, a lag could only be told from how a speed settles, no longer from the way that it costs.
    """
    n = len(duties_pct)
    changes = np.concatenate(([0], np.flatnonzero(np.diff(duties_pct)) + 1, [n]))
    edges = np.linspace(0, n, pieces + 1).astype(int)
    reach = n // (4 * pieces)
    found = [0]
    for edge in edges[1:-1]:
        near = np.arange(edge - reach, edge + reach + 1)
        after = np.searchsorted(changes, near, side="right")
        away = np.minimum(near - changes[after - 1], changes[after] - near)
        best = near[away == away.max()]
        found.append(int(best[np.argmin(np.abs(best - edge))]))
    return [*found, n]


def folds(records: Sequence[Record], most: int = 6) -> tuple[list[Record], list[list[int]]]:
    """The records to fit, and the groups of them to leave out in turn.

    Groups are whole experiments, repeats together; where there are fewer than three, records are cut in time and the
    pieces are left out.
    """
    experiments = [*repeats(records)]
    grouped = {i for g in experiments for i in g}
    experiments.extend([i] for i in range(len(records)) if i not in grouped)
    counts = [1] * len(records)
    if len(experiments) < 3:
        for record in records:
            if len(record) < SHORTEST_CUT:
                raise DataError(
                    f"{record.name}: {len(record)} samples are too few to be cut in pieces, as is done with fewer than "
                    f"three experiments; at least {SHORTEST_CUT} are needed"
                )
        counts = [max(2, min(4, int(r.seconds // 4), len(r) // (2 * SHORTEST))) for r in records]
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
        if unchanged(model, kept, starts=starts, windows=fitted.windows).cost <= before:
            return model
    return fitted.model


def only_in(fitted: Fit, name: str, groups: Sequence[Sequence[int]]) -> Sequence[int] | None:
    """The one group of records that knows the parameters of an effect, or None where others do: without it they would
    stay as they are (``without_group``), so that leaving it out confirms nothing.
    """
    columns = [i for i, key in enumerate(fitted.names) if key.partition(".")[0] == name]
    known = np.array([sum(np.sum(fitted.jacobians[i][:, columns] ** 2, axis=0) for i in group) for group in groups])
    which = int(np.argmax(known.sum(axis=1)))
    rest = known.sum(axis=0) - known[which]
    return groups[which] if columns and (rest <= ELSEWHERE * known[which]).all() else None


def validate(fitted: Fit, cv_records: Sequence[Record], groups: Sequence[Sequence[int]]) -> Validated:
    """Cross-validate the structure of a fitted model: what each group of records, left out, makes of the rest's fit."""
    blocks: list[float] = []
    costs: list[float] = []
    for group in groups:
        out = [cv_records[i] for i in group]
        model, starts = without_group(fitted, cv_records, group), [fitted.starts[i] for i in group]
        seen = unchanged(model, out, starts=starts, windows=fitted.windows)
        for record, residual in zip(out, seen.residuals, strict=True):
            size = max(1, round(BLOCK_S / record.sample_time_s))
            blocks.extend(float(residual[a : a + size] @ residual[a : a + size]) for a in range(0, len(residual), size))
        costs.append(seen.cost)
    return Validated(fitted, np.array(blocks), np.array(costs))


def objection(found: Fit, name: str, replicas: Sequence[Model] = ()) -> str | None:
    """Why a fitted effect cannot be believed by its parameters alone, or None; replicas as for ``estimates``."""
    known = _smooth(found, name, replicas)
    bounds = (_at_a_bound(p, value) for p, value in known)
    return next((why for why in bounds if why), None) or _vanishing(found, name, known)


def only_at_a_bound(found: Fit, name: str) -> bool:
    """Whether all that speaks against a fitted effect is a parameter at its bound, while the others are distinct.

    So ends what data can only tell the sum of, as dry friction and a deadband that are never turned against.
    """
    known = _smooth(found, name)
    free = [(p, value) for p, value in known if not _at_a_bound(p, value)]
    return 0 < len(free) < len(known) and _vanishing(found, name, free) is None


def _smooth(found: Fit, name: str, replicas: Sequence[Model] = ()) -> list[tuple[Parameter, Estimate]]:
    known = estimates(found, replicas)
    return [(p, known[f"{name}.{p.name}"]) for p in found.model.parts()[-1].parameters if p.is_smooth]


def _at_a_bound(parameter: Parameter, value: Estimate) -> str | None:
    if value.at_bound and (value.value != 0.0 or parameter.neutral is not None):
        # Nothing in nature is below zero; any other bound is one of the search.
        return f"{parameter.name} went to its bound {value.value:g} {parameter.unit}"
    return None


def _vanishing(found: Fit, name: str, known: Sequence[tuple[Parameter, Estimate]]) -> str | None:
    """What says that the effect may as well not be there; one of several sizes is not distinct from none unless all
    are, together (Wald's test): data may know their difference and nothing of their sum.
    """
    # A ragged parameter has no width by gradients: the fit and the left-out records judge it.
    sizes = [(p, value, p.neutral) for p, value in known if p.neutral is not None and not p.ragged]
    whys = []
    for parameter, value, neutral in sizes:
        if abs(value.value - neutral) < 1e-9:
            whys.append(f"{parameter.name} went to {neutral:g}, where the effect vanishes")
        elif value.half_width / 1.96 * SIGMAS_FROM_NEUTRAL > abs(value.value - neutral):
            whys.append(f"{parameter.name} is not distinct from {neutral:g}, where the effect vanishes")
    if len(whys) == len(sizes) > 1:
        cov, _ = covariance(found)
        at = [found.names.index(f"{name}.{p.name}") for p, _, _ in sizes]
        away = np.array([value.value - neutral for _, value, neutral in sizes])
        block = cov[np.ix_(at, at)]
        if np.isfinite(block).all() and away @ np.linalg.pinv(block, hermitian=True) @ away > SIGMAS_FROM_NEUTRAL**2:
            return None
    return whys[0] if whys and len(whys) == len(sizes) else None


def indistinguishable(best: Validated, rival: Validated, base_cost: float) -> bool:
    """Whether a rival does as well as the best on left-out data, within what the data can tell."""
    if rival.cost <= best.cost * CLOSE**2:
        return True
    gain, rival_gain = base_cost - best.cost, base_cost - rival.cost
    if rival_gain < SHARED_GAIN * gain:
        return False
    difference = rival.blocks - best.blocks
    error = float(difference.std(ddof=1)) * np.sqrt(len(difference))
    return bool(difference.sum() < 2.0 * error)
