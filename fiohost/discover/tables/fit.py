"""Least squares of a model to tables, in floors; the result is a ``Fit`` like that of logs, one residual a row.

So intervals, replicas and objections are those of the log search. What a log has in its initial states a table has in
the constants of its bench: they are fitted alongside and their part is taken out of the derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from scipy.optimize import least_squares, minimize

from fiohost.control.closed_loop import Plant
from fiohost.discover.tables.settings import SETTINGS
from fiohost.discover.tables.table import Constant, Figure, Row, Table
from fiohost.estimation.fit import Fit
from fiohost.estimation.solver import project
from fiohost.motor.model import Model, slot


@dataclass(frozen=True)
class TableFit(Fit):
    """A model fitted to tables: residuals and derivatives, one array a row, in floors.

    ``constants`` are the values of each table's constants, ``predicted`` the figures of each row by name.
    """

    constants: tuple[tuple[float, ...], ...] = ()
    predicted: tuple[Mapping[str, float], ...] = ()

    @property
    def seen(self) -> np.ndarray:
        """Which parameters (k) change the figures at all."""
        columns = np.vstack(self.jacobians) if self.jacobians else np.empty((0, len(self.names)))
        return np.asarray(np.linalg.norm(columns, axis=0) > SETTINGS.seen)


@dataclass(frozen=True)
class Place:
    """One row of all tables."""

    table: int
    index: int
    row: Row


class Rows:
    """All rows of all tables, in one order, and how far a model is from them."""

    def __init__(self, tables: Sequence[Table]) -> None:
        self.tables = tables
        self.places = [Place(t, i, row) for t, table in enumerate(tables) for i, row in enumerate(table.rows)]
        self.fitted = [(t, i) for t, table in enumerate(tables) for i, c in enumerate(table.constants) if c.fitted]
        self.samples = sum(len(place.row.measured) for place in self.places)

    def __len__(self) -> int:
        return len(self.places)

    def figures(self, place: Place) -> list[Figure]:
        """The figures that were measured in a row."""
        return [f for f in self.tables[place.table].figures if f.name in place.row.measured]

    def constant(self, which: tuple[int, int]) -> Constant:
        return self.tables[which[0]].constants[which[1]]

    def known(self) -> list[list[float]]:
        return [[c.value for c in table.constants] for table in self.tables]

    def label(self, place: Place) -> str:
        """A row's name, with its table's where there are several."""
        return place.row.label if len(self.tables) == 1 else f"{self.tables[place.table].name}: {place.row.label}"

    def measured(self, place: Place) -> np.ndarray:
        """The readings of a row, in floors."""
        return np.array([place.row.measured[f.name] / f.floor for f in self.figures(place)])

    def noise(self, rng: np.random.Generator) -> list[np.ndarray]:
        """One draw of what rounding and scatter add to every row, in floors."""
        return [np.array([f.noise_floors(rng) for f in self.figures(p)]) for p in self.places]

    def predict(self, place: Place, plant: Plant, constants: Sequence[Sequence[float]]) -> Mapping[str, float]:
        return self.tables[place.table].predict(plant, place.index, constants[place.table])

    def in_floors(self, place: Place, predicted: Mapping[str, float]) -> np.ndarray:
        values = (predicted[f.name] / f.floor for f in self.figures(place))
        return np.array([v if isfinite(v) else (-SETTINGS.far_off if v < 0.0 else SETTINGS.far_off) for v in values])


def squares(left: np.ndarray) -> float:
    return float(left @ left)


class _Problem:
    """Predictions (in floors) of some rows by a vector of the model's free parameters and the fitted constants."""

    def __init__(self, data: Rows, model: Model, rows: Sequence[int]) -> None:
        self.data, self.model = data, model
        self.places = [data.places[i] for i in rows]
        self.names = tuple(model.free())
        self.slots = np.array([slot(n) for n in self.names], dtype=np.int64)
        self.plant = Plant.of(model)
        parameters = [model.parameter(n) for n in self.names]
        constants = [data.constant(which) for which in data.fitted]
        self.lower = np.array([*(q.lower for q in parameters), *(c.lower for c in constants)])
        self.upper = np.array([*(q.upper for q in parameters), *(c.upper for c in constants)])
        self.steps = np.array([*(q.step for q in parameters), *(SETTINGS.constant_step for _ in constants)])
        relative = [q.relative_step for q in parameters]
        self.relative = np.array([*relative, *(c.upper > 1.0 for c in constants)], dtype=np.bool_)
        self.steps[: len(parameters)][np.array(relative, dtype=np.bool_)] *= SETTINGS.wider
        self._last: tuple[np.ndarray, np.ndarray] | None = None

    def split(self, x: np.ndarray) -> tuple[Plant, list[list[float]]]:
        """The motor and the constants of a vector."""
        p = self.plant.p.copy()
        p[self.slots] = x[: len(self.slots)]
        constants = self.data.known()
        for (table, i), value in zip(self.data.fitted, x[len(self.slots) :], strict=True):
            constants[table][i] = float(value)
        return self.plant.at(p), constants

    def rows(self, x: np.ndarray) -> list[np.ndarray]:
        plant, constants = self.split(x)
        return [self.data.in_floors(p, self.data.predict(p, plant, constants)) for p in self.places]

    def values(self, x: np.ndarray) -> np.ndarray:
        """All figures (n); those of the last vector are remembered, as its derivatives are asked for next."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x.copy(), np.concatenate(self.rows(x))
        return self._last[1]

    def columns(self, x: np.ndarray, among: np.ndarray | None = None) -> np.ndarray:
        """Derivatives (figures, parameters), one difference each, turned inward at a bound; of those ``among`` (k)."""
        base = self.values(x)
        which = np.arange(len(x)) if among is None else np.flatnonzero(among)
        out = np.empty((len(base), len(which)))
        for k, j in enumerate(which.tolist()):
            step = self.steps[j] * (max(abs(x[j]), 1e-9) if self.relative[j] else 1.0)
            if x[j] + step > self.upper[j]:
                step = -step
            moved = x.copy()
            moved[j] += step
            out[:, k] = (np.concatenate(self.rows(moved)) - base) / step
        return out

    def shown(self, x: np.ndarray) -> tuple[np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """Which numbers of a vector the figures show at all, and the vector with these replaced: the others stay, as
        no step along them is known.
        """
        seen = np.linalg.norm(self.columns(x), axis=0) > SETTINGS.seen

        def whole(v: np.ndarray) -> np.ndarray:
            out = x.copy()
            out[seen] = v
            return out

        return seen, whole

    def solve(self, x: np.ndarray, measured: np.ndarray, evaluations: int, jumps: float = 0.0) -> np.ndarray:
        """The vector of least squares from a start, within bounds; errors beyond ``jumps`` floors weigh little where
        that is given (Cauchy's cost).
        """
        x = np.clip(x, self.lower, self.upper)
        seen, whole = self.shown(x)
        if not seen.any():
            return x
        lower, upper = self.lower[seen], self.upper[seen]

        def left(v: np.ndarray) -> np.ndarray:
            return np.asarray(self.values(whole(v)) - measured)

        def columns(v: np.ndarray) -> np.ndarray:
            return self.columns(whole(v), seen)

        found = least_squares(
            left,
            x[seen],
            jac=columns,
            bounds=(lower, upper),
            x_scale="jac",
            loss="cauchy" if jumps else "linear",
            f_scale=jumps or 1.0,
            ftol=1e-5,
            xtol=1e-6,
            gtol=1e-10,
            max_nfev=evaluations,
        )
        solved = np.asarray(found.x)
        # An interior method stops just inside a bound.
        near = 1e-6 * np.maximum(np.abs(x[seen]), 1e-3)
        solved = np.where(solved - lower <= near, lower, solved)
        return whole(np.where(upper - solved <= near, upper, solved))

    def settle(self, x: np.ndarray, measured: np.ndarray, looks: int) -> np.ndarray:
        """A vector walked on by a simplex (Nelder and Mead), which jumps of the figures do not stop."""
        seen, whole = self.shown(x)
        if not seen.any():
            return x
        reach = np.linalg.norm(self.columns(x), axis=0)
        size = SETTINGS.reach * np.sqrt(squares(self.values(x) - measured) + len(measured)) / np.maximum(reach, 1e-12)
        size = np.minimum(size, np.maximum(SETTINGS.most_reach * np.abs(x), self.steps))
        size = np.where(x + size > self.upper, -size, size)[seen]

        def left(v: np.ndarray) -> float:
            return squares(self.values(whole(v)) - measured)

        found = minimize(
            left,
            x[seen],
            method="Nelder-Mead",
            bounds=list(zip(self.lower[seen], self.upper[seen], strict=True)),
            options={
                "initial_simplex": np.vstack((x[seen], x[seen] + np.diag(size))),
                "maxfev": looks,
                "fatol": 1e-3,
                "xatol": np.inf,
            },
        )
        return whole(np.asarray(found.x))


def vector(data: Rows, model: Model, constants: Sequence[Sequence[float]] | None = None) -> np.ndarray:
    """The free parameters of a model and the fitted constants."""
    given = constants if constants is not None else data.known()
    return np.array([*(model.number(n) for n in model.free()), *(given[t][i] for t, i in data.fitted)])


def fit_tables(
    data: Rows,
    model: Model,
    *,
    constants: Sequence[Sequence[float]] | None = None,
    noise: Sequence[np.ndarray] | None = None,
    evaluations: int = SETTINGS.evaluations,
    looks: int = 0,
    jumps: float = 0.0,
    derive: bool = True,
) -> TableFit:
    """Fit a model's free parameters, from the values it has; with no evaluations, judge it as it is.

    ``looks`` of a simplex are taken beyond the solution, errors beyond ``jumps`` floors weigh little. ``noise`` (one
    array a row, in floors) fits to what the model itself predicts plus this, in place of the readings. Without
    ``derive`` the fit has no derivatives, which take one simulation a parameter.
    """
    problem = _Problem(data, model, range(len(data)))
    x = vector(data, model, constants)
    measured = (
        [data.measured(p) for p in data.places]
        if noise is None
        else [y + e for y, e in zip(problem.rows(x), noise, strict=True)]
    )
    if evaluations:
        x = problem.solve(x, np.concatenate(measured), evaluations, jumps)
    if looks:
        x = problem.settle(x, np.concatenate(measured), looks)
        x = problem.solve(x, np.concatenate(measured), SETTINGS.nearby)
    return _fit_at(problem, x, measured, derive)


def _fit_at(problem: _Problem, x: np.ndarray, measured: Sequence[np.ndarray], derive: bool) -> TableFit:
    """The figures of a vector as a fit."""
    data, k = problem.data, len(problem.slots)
    plant, constants = problem.split(x)
    predicted = [data.predict(p, plant, constants) for p in problem.places]
    base = [data.in_floors(p, y) for p, y in zip(problem.places, predicted, strict=True)]
    columns = problem.columns(x) if derive else np.zeros((sum(len(y) for y in base), len(x)))
    edges = np.cumsum([len(y) for y in base])[:-1]
    residuals = tuple(m - y for m, y in zip(measured, base, strict=True))
    names = dict(zip(problem.names, (float(v) for v in x[:k]), strict=True))
    nuisance = columns[:, k:]
    return TableFit(
        model=problem.model.with_values(names),
        names=problem.names,
        cost=float(sum(float(r @ r) for r in residuals)),
        residuals=residuals,
        jacobians=tuple(np.split(project(columns[:, :k], nuisance), edges)),
        nuisances=tuple(np.split(nuisance, edges)),
        starts=(),
        converged=True,
        samples=float(sum(len(r) for r in residuals)),
        constants=tuple(tuple(c) for c in constants),
        predicted=tuple(predicted),
    )


def deviations(data: Rows, model: Model, constants: Sequence[Sequence[float]]) -> np.ndarray:
    """What a model as it is leaves of all figures (n), in floors."""
    plant = Plant.of(model)
    left = [data.measured(p) - data.in_floors(p, data.predict(p, plant, constants)) for p in data.places]
    return np.concatenate(left)


def without_row(data: Rows, fitted: TableFit, row: int, looks: int = 0) -> np.ndarray:
    """What is left of a row (in floors) by the model fitted to the others, with ``looks`` of a simplex beyond that."""
    rest = [i for i in range(len(data)) if i != row]
    problem = _Problem(data, fitted.model, rest)
    measured = np.concatenate([data.measured(data.places[i]) for i in rest])
    x = problem.solve(vector(data, fitted.model, fitted.constants), measured, SETTINGS.nearby)
    if looks:
        x = problem.settle(x, measured, looks)
    plant, constants = problem.split(x)
    place = data.places[row]
    return np.asarray(data.measured(place) - data.in_floors(place, data.predict(place, plant, constants)))


def shown_by_one_row(fitted: TableFit, name: str) -> bool:
    """Whether a single row is all that an effect's sizes change, or where it has none its shape, so that no other can
    confirm it.
    """
    own = [j for j, key in enumerate(fitted.names) if key.partition(".")[0] == name]
    sizes = [j for j in own if fitted.model.parameter(fitted.names[j]).neutral is not None]
    changed = [sum(np.linalg.norm(columns[:, j]) > SETTINGS.seen for columns in fitted.jacobians) for j in sizes or own]
    return bool(own) and all(rows <= 1 for rows in changed)
