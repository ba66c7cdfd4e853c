"""What a single explanation is worth: an effect fitted beside a stage like any candidate, believed or not."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from fiohost.discover.tables.fit import Evidence, TableFit
from fiohost.discover.tables.search import Search, TableStage, can_be_left_out, left_out
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


def worth(search: Search, stage: TableStage, name: str) -> Worth:
    """One effect beside a stage: what it leaves, and why it is not believed (None: it is). Raises ConfigError for an
    effect that tables say nothing of or that the model has.
    """
    item = effect(name)
    if name in stage.fit.model.effects or name == "linear":
        raise ConfigError(f"{name} is part of {stage.fit.model.expression} already")
    if item.angle_bound or item.trials_for is not None or not item.trials:
        what = "angle" if item.angle_bound else "time"
        raise ConfigError(f"{name} cannot be tried: a table of readings does not say at which {what}")
    (fitted,) = search.refits(stage.fit, [item])
    if fitted is None:
        return Worth(name, None, stage.fit.rms, stage.left_out_rms, "leaves no trace in these figures")
    why = search.unbelievable(stage, item, fitted, search.chance(stage.fit, fitted, 1))
    return Worth(name, fitted, fitted.rms, left_out_rms(search.evidence, fitted), why)


def left_out_rms(evidence: Evidence, fitted: TableFit, looks: int = 0) -> float | None:
    """Error of rows left out of a fit in turn, in floors.

    Figures jump, so that a fit may stay where it is when a row is taken away, and remember that row; ``looks`` of a
    simplex walk it on.
    """
    if not can_be_left_out(evidence, fitted):
        return None
    return float(np.sqrt(np.mean(np.concatenate(left_out(evidence, fitted, looks)) ** 2)))


def scatter_needed(rms: float, limit_rms: float) -> float:
    """Standard deviation in floors that readings would need beside their rounding for a model to pass; 0 if it does."""
    return sqrt(max((rms / limit_rms) ** 2 - 1.0, 0.0))
