"""Is the residual at its floor? Each figure of each record against the same figure of the replicas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.discover.floor import Floor
from fiohost.discover.metrics import Errors, Judgement

FIGURES = ("free_run_rms", "window_rms", "bin_violation_pct")
# A model that is right but for the last digits of its parameters stays within these factors of its replicas.
TOLERANCE = {"free_run_rms": 1.25, "window_rms": 1.03, "bin_violation_pct": 1.0}
VIOLATION_MARGIN_PCT = 1.0
SIGMAS = 4.0


@dataclass(frozen=True)
class Excess:
    """How far one figure of one record stands above its replicas."""

    record: str
    figure: str
    value: float
    limit: float

    @property
    def exceeded(self) -> bool:
        return self.value > self.limit


def _limit(figure: str, floor: Floor) -> float:
    draws = np.array([getattr(e, figure) for e in floor.draws], dtype=float)
    mean, spread = float(draws.mean()), float(draws.std(ddof=1)) if len(draws) > 1 else 0.0
    top = max(mean + SIGMAS * spread, float(draws.max()))
    if figure == "bin_violation_pct":
        return top + VIOLATION_MARGIN_PCT
    top = max(top, mean * TOLERANCE[figure])
    if floor.source == "repeats":
        top = max(top, getattr(floor.errors, figure) * TOLERANCE[figure])
    return top


def excesses(names: Sequence[str], judgements: Sequence[Judgement], floors: Sequence[Floor]) -> list[Excess]:
    """Every tested figure of every record with its limit; figures that a record does not have are left out."""
    found = []
    for name, judgement, floor in zip(names, judgements, floors, strict=True):
        figures = FIGURES if floor.source == "replicas" else FIGURES[:2]
        for figure in figures:
            value = getattr(judgement.errors, figure)
            if value is None or getattr(floor.draws[0], figure) is None:
                continue
            found.append(Excess(name, figure, float(value), _limit(figure, floor)))
    return found


def at_floor(found: Sequence[Excess]) -> bool:
    return not any(e.exceeded for e in found)


def ratio(errors: Errors, floor: Errors) -> float:
    """Window rms over its floor, infinite where the floor is zero."""
    return errors.window_rms / floor.window_rms if floor.window_rms > 0 else np.inf
