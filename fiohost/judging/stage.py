"""A fitted model judged: its figures on the training records beside the floor they could reach."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fiohost.estimation.fit import Fit
from fiohost.estimation.record import ANGLE, Record
from fiohost.judging.floor import Floor, floors, refitted_models, replica_models
from fiohost.judging.metrics import Errors, Judgement, judge, pool
from fiohost.judging.settings import FLOOR
from fiohost.judging.verdict import Excess, at_floor, beyond, excesses, far_above, near_limit, no_matter, open_still
from fiohost.motor.model import Model
from fiohost.workers import each

_Drawn = tuple[list[Floor], list[Excess]]


@dataclass(frozen=True)
class Stage:
    """A fitted model with its judgements on the training records.

    ``scatter`` fits models to replicas of the data, from benches whose shafts stand elsewhere within their counts.
    ``motion_rms`` is that of the output in one-second windows, of an angle about its mean.
    """

    fit: Fit
    scatter: Callable[[], Sequence[Model]]
    judgements: tuple[Judgement, ...]
    floors: tuple[Floor, ...]
    excesses: tuple[Excess, ...]
    motion_rms: float = float("inf")

    @cached_property
    def scattered_models(self) -> tuple[Model, ...]:
        """What would have been fitted to replicas of the data: they carry the error of estimation, for intervals."""
        return tuple(self.scatter())

    @property
    def left_pct(self) -> float:
        """Error of one-second windows as a share of the motion in them."""
        errors = pool([j.errors for j in self.judgements])
        return 100.0 * errors.window_rms / self.motion_rms if errors else 0.0

    @property
    def at_floor(self) -> bool:
        return at_floor(self.excesses)

    @property
    def follows(self) -> bool:
        """Whether the model follows the data as closely as it matters, at the floor or a fraction of a count off."""
        return no_matter(self.excesses)

    @property
    def floor_rms(self) -> float:
        """Floor of what was fitted, all records together, weighted as by a fit; infinite where there is none."""
        if self.fit.windows:
            floor = pool([f.errors for f in self.floors])
            return floor.window_rms if floor and floor.window_rms > 0.0 else float("inf")
        squares = [f.weighted_square for f in self.floors]
        weight = sum(j.weighed.weight for j in self.judgements)
        return float(np.sqrt(sum(squares) / weight)) if sum(squares) > 0.0 else float("inf")

    def left_of(self, other: Fit, records: Sequence[int]) -> float:
        """Error of another fit in some of its records, as a multiple of their floor; of all if they are but pieces."""
        if len(other.residuals) != len(self.floors):
            return other.rms / self.floor_rms
        squares = sum(float(other.residuals[i] @ other.residuals[i]) for i in records)
        if other.windows:
            floor = sum(len(other.residuals[i]) * self.floors[i].errors.window_rms ** 2 for i in records)
        else:
            floor = sum(self.floors[i].weighted_square for i in records)
        return float(np.sqrt(squares / floor)) if floor > 0.0 else float("inf")

    @property
    def powers(self) -> tuple[float, ...]:
        """Mean squares of what counts, all records together: of one-second windows, and of free runs where fitted."""
        return self._counting([j.errors for j in self.judgements])

    @property
    def powers_above_floor(self) -> tuple[float, ...]:
        """The same, without those of the floor."""
        floors = self._counting([f.errors for f in self.floors])
        return tuple(max(power - floor, 0.0) for power, floor in zip(self.powers, floors, strict=True))

    @property
    def windows_above_floor(self) -> float:
        """Power of the one-second windows, all records together, above that of their floor, as a share of it."""
        floor = self._counting([f.errors for f in self.floors])[0]
        return self.powers_above_floor[0] / floor if floor > 0.0 else 0.0

    def _counting(self, errors: Sequence[Errors]) -> tuple[float, ...]:
        pooled = pool(errors)
        both = (pooled.window_rms**2, pooled.free_run_rms**2) if pooled else (0.0, 0.0)
        return both[:1] if self.fit.windows else both


def judged(fitted: Fit, fitted_records: Sequence[Record], records: Sequence[Record], rng: np.random.Generator) -> Stage:
    """Judge a fit on whole records; it may have been fitted to pieces of them.

    Replicas of each record are drawn until they can say no more: few where the fit stands far above all that they
    reach, more where it stands well among them, many where it stands just above their highest.
    """
    whole = not fitted.windows and len(fitted.starts) == len(records)
    starts = fitted.starts if whole else [None] * len(records)
    judgements = each(lambda i: judge(records[i], fitted.model, fitted=starts[i]), range(len(records)))

    def scatter(count: int = FLOOR.replicas, anywhere: bool = True) -> list[Model]:
        return replica_models(fitted, fitted_records, rng, count, anywhere=anywhere)

    def estimated() -> list[Model]:
        moved = fitted.windows and any(r.disturbance and r.disturbance.noise.torque_known for r in fitted_records)
        return refitted_models(fitted, fitted_records, rng) if moved else scatter()

    def drawn(models: Sequence[Model], asked: Collection[str], before: Sequence[Floor]) -> _Drawn:
        found = floors(records, fitted.model, judgements, models, rng, before, asked)
        return found, excesses(records, judgements, found)

    found, above = drawn(scatter(FLOOR.few, anywhere=False), {r.name for r in records}, ())
    if not far_above(above):
        found, above = drawn(scatter(FLOOR.some - FLOOR.few, anywhere=False), {r.name for r in records}, found)
        if asked := open_still(above):
            found, above = drawn(scatter(FLOOR.replicas - FLOOR.some, anywhere=False), asked, found)
    for _ in range(FLOOR.more_replicas // FLOOR.replicas):
        if no_matter(above) or not near_limit(above):
            break
        # So near, the error of estimation counts in full: whether a shaft rests or creeps hangs on the last digits.
        found, above = drawn(scatter(), beyond(above), found)
    return Stage(fitted, estimated, tuple(judgements), tuple(found), tuple(above), motion_rms(records))


def motion_rms(records: Sequence[Record]) -> float:
    """How much there is to explain in one-second windows: rms of the output in them, of an angle about its mean."""
    square, samples = 0.0, 0
    for record in records:
        for a, b in zip(record.windows[:-1].tolist(), record.windows[1:].tolist(), strict=True):
            part = record.y[a:b] - (record.y[a:b].mean() if record.kind == ANGLE else 0.0)
            square, samples = square + float(part @ part), samples + len(part)
    return float(np.sqrt(square / max(samples, 1))) or float("inf")
