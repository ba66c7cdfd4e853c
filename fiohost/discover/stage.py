"""A fitted model judged: its figures on the training records beside the floor they could reach."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.discover.floor import MORE_REPLICAS, REPLICAS, Floor, floors, replica_models
from fiohost.discover.metrics import Errors, Judgement, judge, pool
from fiohost.discover.verdict import Excess, at_floor, excesses, near_limit
from fiohost.discover.workers import each
from fiohost.estimation.fit import Fit
from fiohost.estimation.record import Record
from fiohost.motor.model import Model


@dataclass(frozen=True)
class Stage:
    """A fitted model with its judgements on the training records.

    ``replica_models`` are what would have been fitted to replicas of the data: they carry the error of estimation.
    ``scattered_models`` likewise, from benches whose shafts stand elsewhere within their counts: for intervals.
    """

    fit: Fit
    replica_models: tuple[Model, ...]
    scattered_models: tuple[Model, ...]
    judgements: tuple[Judgement, ...]
    floors: tuple[Floor, ...]
    excesses: tuple[Excess, ...]

    @property
    def at_floor(self) -> bool:
        return at_floor(self.excesses)

    @property
    def floor_rms(self) -> float:
        """Free-run floor of all records together, weighted as a fit weighs them; infinite where there is none."""
        squares = [f.weighted_square for f in self.floors]
        weight = sum(j.weighed.weight for j in self.judgements)
        return float(np.sqrt(sum(squares) / weight)) if sum(squares) > 0.0 else float("inf")

    @property
    def powers(self) -> tuple[float, float]:
        """Mean squares of free runs and of one-second windows, all records together."""
        return _powers([j.errors for j in self.judgements])

    @property
    def powers_above_floor(self) -> tuple[float, float]:
        """The same, without those of the floor."""
        (free, windows), (free_floor, windows_floor) = self.powers, _powers([f.errors for f in self.floors])
        return max(free - free_floor, 0.0), max(windows - windows_floor, 0.0)

    @property
    def windows_above_floor(self) -> float:
        """Power of the one-second windows, all records together, above that of their floor, as a share of it."""
        floor = _powers([f.errors for f in self.floors])[1]
        return self.powers_above_floor[1] / floor if floor > 0.0 else 0.0


def _powers(errors: Sequence[Errors]) -> tuple[float, float]:
    pooled = pool(errors)
    return (pooled.free_run_rms**2, pooled.window_rms**2) if pooled else (0.0, 0.0)


def judged(fitted: Fit, fitted_records: Sequence[Record], records: Sequence[Record], rng: np.random.Generator) -> Stage:
    """Judge a fit on whole records; it may have been fitted to pieces of them."""
    judgements = each(lambda r: judge(r, fitted.model), records)
    names = [r.name for r in records]
    models = replica_models(fitted, fitted_records, rng)
    found = floors(records, fitted.model, judgements, models, rng)
    above = excesses(names, judgements, found)
    near = near_limit(above)
    scattered = replica_models(fitted, fitted_records, rng, MORE_REPLICAS if near else REPLICAS, anywhere=True)
    if near:
        # So near, the error of estimation counts in full: whether a shaft rests or creeps hangs on the last digits.
        found = floors(records, fitted.model, judgements, [*models, *scattered], rng)
        above = excesses(names, judgements, found)
    return Stage(fitted, tuple(models), tuple(scattered[:REPLICAS]), tuple(judgements), tuple(found), tuple(above))
