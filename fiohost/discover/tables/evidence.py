"""Tables of readings as evidence: figures against their digits and scatter, validated on rows left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from fiohost.discover.candidate import Candidate, Progress
from fiohost.discover.evidence import Evidence, State
from fiohost.discover.null import Decided, Null
from fiohost.discover.score import Gain, at_a_bound
from fiohost.discover.tables.fit import Rows, TableFit, fit_tables, shown_by_one_row, without_row
from fiohost.discover.tables.settings import SETTINGS as TABLES
from fiohost.discover.tables.starts import (
    downhill,
    fit_anew,
    fit_declared,
    held,
    to_the_end,
)
from fiohost.discover.tables.table import Table
from fiohost.estimation.intervals import Estimate, estimates
from fiohost.judging.levels import levels_of
from fiohost.motor.effect import Effect, effects
from fiohost.motor.model import Model
from fiohost.workers import each


@dataclass(frozen=True)
class TableStage:
    """A fitted model beside what chance alone would leave of it.

    ``left_out`` are its residuals, one array a row, by the model fitted to the other rows (None: too few of them);
    ``floor_rms`` and ``limit_rms`` are the mean and the top of the errors of replicas, each fitted anew.
    """

    fit: TableFit
    replica_models: tuple[Model, ...]
    floor_rms: float
    limit_rms: float
    left_out: tuple[np.ndarray, ...] | None
    left_pct: float = float("inf")

    @property
    def follows(self) -> bool:
        return self.fit.rms <= self.limit_rms

    @property
    def left_out_rms(self) -> float | None:
        return None if self.left_out is None else float(np.sqrt(np.mean(np.concatenate(self.left_out) ** 2)))

    def parameters(self) -> dict[str, Estimate]:
        return estimates(self.fit, self.replica_models)


class Readings(Evidence[TableStage]):
    """Rows of tables, their figures in floors: the standard deviation of a reading of a true model."""

    def __init__(self, tables: Sequence[Table], rng: np.random.Generator | None = None) -> None:
        super().__init__(rng)
        self.rows = Rows(tables)
        self._left_out: dict[int, tuple[TableFit, tuple[np.ndarray, ...]]] = {}

    def fitted(self, state: State) -> TableFit:
        assert isinstance(state.fit, TableFit)
        return state.fit

    def deviance(self, cost: float) -> float:
        """That of a squared error in floors: Gaussian errors of a variance that is not known, but never below that of
        the floor.
        """
        n = float(self.rows.samples)
        return n * float(np.log(cost / n)) + n if cost > n else cost

    def state(self, fitted: TableFit) -> State:
        return State(fitted, self.deviance(fitted.cost))

    def variance(self, state: State) -> float:
        return max(state.fit.cost / self.rows.samples, 1.0)

    def declared(self, model: Model, from_file: bool) -> State:
        return self.state(fit_declared(self.rows, model, keep_start=from_file))

    def judge(self, state: State) -> TableStage:
        """Replicas of a fit's own figures, rounded elsewhere, are fitted by the same model."""
        fitted = self.fitted(state)
        noises = [self.rows.noise(self.rng) for _ in range(self.settings.floor.replicas)]

        def again(noise: Sequence[np.ndarray]) -> TableFit:
            return fit_tables(
                self.rows,
                fitted.model,
                constants=fitted.constants,
                noise=noise,
                evaluations=TABLES.of_a_replica,
            )

        fits = each(again, noises)
        errors = np.array([f.rms for f in fits])
        limit = max(float(errors.mean() + self.settings.verdict.sigmas * errors.std(ddof=1)), float(errors.max()))
        out = self.left_out(fitted) if self.can_be_left_out(fitted) else None
        return TableStage(fitted, tuple(f.model for f in fits), float(errors.mean()), limit, out)

    def without(self, state: State, name: str) -> State:
        fitted = self.fitted(state)
        return self.state(fit_tables(self.rows, fitted.model.without([name]), constants=fitted.constants))

    def beside(self, state: State) -> TablesBeside:
        return TablesBeside(self, state)

    def gain(self, before: State, after: State) -> Gain:
        """Rows are few and each shows something else, so the error of the gain is by the readings' own noise."""
        variance = self.variance(after)
        was, now = (np.concatenate(self.left_out(self.fitted(s))) for s in (before, after))
        moved = float((was - now) @ (was - now)) / variance
        return Gain(float(was @ was - now @ now) / variance, 2.0 * float(np.sqrt(moved)), 0.0)

    def as_good(self, state: State, best: State) -> bool:
        left = np.concatenate(self.left_out(self.fitted(state)))
        at_floor = float(left @ left) <= TABLES.at_floor * self.rows.samples
        return at_floor or state is best or not self.gain(state, best).sure(self.settings)

    def degenerate(self, state: State, names: Sequence[str]) -> str | None:
        """Whether a size may be none, the null and left-out rows say: by an interval it would hang on which other one
        takes up what it does (Hauck and Donner 1977).
        """
        fitted, name = self.fitted(state), names[0]  # those before it were asked about when they were added
        if not self.can_be_left_out(fitted):
            return "its parameters are more than the rows can settle when one of them is left out"
        return at_a_bound(fitted, name)

    def unconfirmed(self, before: State, after: State, name: str) -> str | None:
        one = shown_by_one_row(self.fitted(after), name)
        return "shows in one row only, which no other row confirms" if one else None

    def parameter_count(self, fitted: TableFit) -> int:
        """How many numbers the figures had to settle."""
        return int(np.count_nonzero(fitted.seen)) + len(self.rows.fitted)

    def can_be_left_out(self, fitted: TableFit) -> bool:
        """Whether any one row may be left out and the others still settle the parameters."""
        most = max(len(place.row.measured) for place in self.rows.places)
        return len(self.rows) > 1 and self.rows.samples - most >= self.parameter_count(fitted)

    def left_out(self, fitted: TableFit) -> tuple[np.ndarray, ...]:
        """What is left of each row by the model fitted to the others, in floors."""
        if id(fitted) not in self._left_out:
            found = tuple(without_row(self.rows, fitted, row) for row in range(len(self.rows)))
            self._left_out[id(fitted)] = fitted, found
        return self._left_out[id(fitted)][1]

    def too_few(self, fitted: TableFit) -> str | None:
        """Why so many rows cannot judge a model, or None."""
        count, rows, samples = self.parameter_count(fitted), len(self.rows), self.rows.samples
        if rows >= count and samples > count:
            return None
        figures = f"{samples} figure{'s' if samples > 1 else ''} in {rows} row{'s' if rows > 1 else ''}"
        return (
            f"{figures} cannot judge a model with {count} parameters to be fitted; measure more rows or fix parameters"
        )


class TablesBeside:
    """The library beside one state of tables: figures jump, so that every effect is fitted from several starts."""

    def __init__(self, readings: Readings, state: State) -> None:
        self.readings, self.state, self.base = readings, state, readings.fitted(state)
        self.fits: dict[str, TableFit | None] = {}
        self.best: list[tuple[Effect, State]] = []

    def offered(self, library: Sequence[str] | None) -> tuple[list[Effect], list[Candidate]]:
        able, unable = [], []
        for item in [effects()[n] for n in (effects() if library is None else library)]:
            if item.name == "linear" or item.name in self.base.model.effects:
                continue
            if why := not_shown(item):
                unable.append(Candidate(item.name, 0.0, why))
            elif item.trials:
                able.append(item)
        return able, unable

    def refitted(
        self, offered: Sequence[Effect], say: Progress, *, rival: State | None = None
    ) -> list[tuple[Effect, State]]:
        say(f"refitting {len(offered)} of them")
        rows = self.readings.rows
        starts = each(lambda item: held(rows, self.base, item), offered)
        fits: list[TableFit | None] = [found[0] if found else None for found in starts]
        ways = [(i, start) for i in self._near(fits, TABLES.far) for start in starts[i]]
        for (i, _), fitted in zip(ways, each(lambda way: downhill(rows, way[1]), ways), strict=True):
            best = fits[i]
            fits[i] = fitted if best is None or fitted.cost < best.cost else best

        kept = [(i, found) for i in self._near(fits, TABLES.far) if (found := fits[i]) is not None]
        carried = each(partial(to_the_end, rows), [found for _, found in kept])
        for (i, _), fitted in zip(kept, carried, strict=True):
            fits[i] = fitted
        if not rival and min(self._costs(fits)) > TABLES.enough * rows.samples:
            say("none comes to the floor: beginning anew with each of them")
            shown = [i for i, fitted in enumerate(fits) if fitted is not None]
            for i, fitted in zip(shown, each(lambda i: fit_anew(rows, self.base, offered[i]), shown), strict=True):
                fits[i] = min(fitted, fits[i] or fitted, key=lambda f: f.cost)
        self.fits = {item.name: fitted for item, fitted in zip(offered, fits, strict=True)}
        last = [(offered[i], fits[i]) for i in self._near(fits, TABLES.hopeless)]
        self.best = [(item, self.readings.state(f)) for item, f in last if f is not None and f.jacobians]
        return self.best

    def _costs(self, fits: Sequence[TableFit | None]) -> list[float]:
        return [np.inf if f is None else f.cost for f in fits]

    def _near(self, fits: Sequence[TableFit | None], factor: float) -> list[int]:
        """Which squared errors are not farther from the least, or from the floor, than a factor."""
        costs = self._costs(fits)
        most = factor * max(min(costs), self.readings.rows.samples)
        return [i for i, cost in enumerate(costs) if cost <= most and np.isfinite(cost)]

    def passed_over(self) -> list[Candidate]:
        taken = {item.name for item, _ in self.best}
        least = max(min((f.cost for f in self.fits.values() if f), default=0.0), float(self.readings.rows.samples))
        found = []
        for name, fitted in self.fits.items():
            if fitted is None:
                found.append(Candidate(name, 0.0, "leaves no trace in these figures"))
            elif name not in taken:
                why = f"leaves {np.sqrt(fitted.cost / least):.1f} times the error of the best"
                found.append(Candidate(name, 1.0 - fitted.cost / max(self.base.cost, 1e-300), why))
        return found

    def null(self, best: State, decided: Decided = lambda null: False) -> Null:
        """Bootstrap samples of the figures' noise, and what each candidate's parameters take of them."""
        readings = self.readings
        size, rng = np.sqrt(readings.variance(best)), readings.rng
        draws = [size * np.concatenate(readings.rows.noise(rng)) for _ in range(readings.settings.draws)]
        before = [readings.deviance(_rest(self.base, e)) for e in draws]
        gains = [
            [max(was - readings.deviance(_rest(readings.fitted(state), e)), 0.0) for _, state in self.best]
            for was, e in zip(before, draws, strict=True)
        ]
        levels = levels_of(np.array(gains), readings.settings.gumbel_sigmas).tolist()
        names = [item.name for item, _ in self.best]
        return Null(max(levels, default=0.0), dict(zip(names, levels, strict=True)), ())


def _rest(fitted: TableFit, errors: np.ndarray) -> float:
    """Squared error that a fit's parameters and constants leave of figures' noise (n)."""
    basis, size, _ = np.linalg.svd(np.hstack((np.vstack(fitted.jacobians), np.vstack(fitted.nuisances))), False)
    along = basis[:, size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)].T @ errors
    return float(errors @ errors - along @ along)


def not_shown(item: Effect) -> str | None:
    """Why a table says nothing of an effect, or None."""
    if item.angle_bound or item.trials_for is not None:
        what = "angle" if item.angle_bound else "time"
        return f"a table of readings does not say at which {what}"
    return None
