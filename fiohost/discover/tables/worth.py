"""What a single explanation is worth: an effect fitted beside a node like any candidate, believed or not."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from fiohost.discover.belief import Belief
from fiohost.discover.nodes import Child, Node
from fiohost.discover.tables.evidence import Readings, not_shown
from fiohost.discover.tables.fit import TableFit, without_row
from fiohost.errors import ConfigError
from fiohost.motor.effect import effect


@dataclass(frozen=True)
class Worth:
    """An explanation fitted; errors are rms in floors. ``left_out_rms`` is None where no row can be left out, and
    ``fit`` where the effect leaves no trace.
    """

    name: str
    fit: TableFit | None
    rms: float
    left_out_rms: float | None
    why_not: str | None = None


def worth(readings: Readings, node: Node, name: str) -> Worth:
    """One effect beside a node: what it leaves, and why it is not believed (None: it is). Raises ConfigError for an
    effect that tables say nothing of or that the model has.
    """
    item, model = effect(name), node.state.fit.model
    if name in model.effects or name == "linear":
        raise ConfigError(f"{name} is part of {model.expression} already")
    if why_not := not_shown(item) or (None if item.trials else "it has no size to begin from"):
        raise ConfigError(f"{name} cannot be tried: {why_not}")
    beside = readings.beside(node.state)
    found = beside.refitted([item], lambda text: None)
    if not found:
        stage = readings.stage(node.state)
        return Worth(name, None, stage.fit.rms, stage.left_out_rms, "leaves no trace in these figures")
    state = found[0][1]
    child = Child(item, state, node.state.deviance - state.deviance)
    why = Belief(readings).objection(node, child, beside.null(state))
    fitted = readings.fitted(state)
    return Worth(name, fitted, fitted.rms, left_out_rms(readings, fitted), why)


def left_out_rms(readings: Readings, fitted: TableFit, looks: int = 0) -> float | None:
    """Error of rows left out of a fit in turn, in floors.

    Figures jump, so that a fit may stay where it is when a row is taken away, and remember that row; ``looks`` of a
    simplex walk it on.
    """
    if not readings.can_be_left_out(fitted):
        return None
    left = [without_row(readings.rows, fitted, row, looks) for row in range(len(readings.rows))]
    return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))


def scatter_needed(rms: float, limit_rms: float) -> float:
    """Standard deviation in floors that readings would need beside their rounding for a model to pass; 0 if it does."""
    return sqrt(max((rms / limit_rms) ** 2 - 1.0, 0.0))
