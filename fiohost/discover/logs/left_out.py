"""What a fit makes of blocks of logs that were left out of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.discover.settings import SETTINGS
from fiohost.estimation.fit import Fit, unchanged
from fiohost.estimation.record import Record
from fiohost.motor.effect import Value
from fiohost.motor.model import Model

SCORE = SETTINGS.score


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
    held = hessian / np.outer(scale, scale) + SCORE.known_anyway * np.eye(len(scale))
    step = np.linalg.solve(held, gradient / scale) / scale
    before = sum(float(fitted.residuals[i] @ fitted.residuals[i]) for i in rest)
    kept, starts = [records[i] for i in rest], [fitted.starts[i] for i in rest]
    for share in SCORE.step_shares:
        values: dict[str, Value] = {}
        for name, change in zip(fitted.names, share * step, strict=True):
            parameter = fitted.model.parameter(name)
            values[name] = float(np.clip(fitted.model.number(name) + change, parameter.lower, parameter.upper))
        model = fitted.model.with_values(values)
        if unchanged(model, kept, starts=starts, windows=fitted.windows, zeros=False).cost <= before:
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
    return groups[which] if columns and (rest <= SCORE.elsewhere * known[which]).all() else None


def left_out(fitted: Fit, variance: float, records: Sequence[Record], groups: Sequence[Sequence[int]]) -> np.ndarray:
    """Deviance of left-out blocks of 2 s: what the fit to the other groups of records makes of each group."""
    blocks: list[float] = []
    for group in groups:
        out = [records[i] for i in group]
        model, starts = without_group(fitted, records, group), [fitted.starts[i] for i in group]
        seen = unchanged(model, out, starts=starts, windows=fitted.windows, zeros=False)
        for record, residual in zip(out, seen.residuals, strict=True):
            size = max(1, round(SCORE.block_s / record.sample_time_s))
            blocks.extend(float(residual[a : a + size] @ residual[a : a + size]) for a in range(0, len(residual), size))
    return np.array(blocks) / variance
