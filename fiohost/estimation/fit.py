"""Simulation-error fit: Levenberg-Marquardt over all records at once, initial states eliminated record by record.

Two costs share one solver. ``windows`` compares one-second windows whose angle and speed are free: nearly convex,
used to come close. ``free`` compares whole free runs with each record's initial angle and speed free: an order of
magnitude sharper, used to finish. Neither ever differentiates the counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from fiohost.errors import DataError
from fiohost.estimation.predict import Begun, Flat, errors, squared, windowed
from fiohost.estimation.record import ANGLE, Record
from fiohost.estimation.starts import first_starts, moved_start, start_columns, taken_up_play, with_origins
from fiohost.estimation.tangent import Tangent
from fiohost.motor.model import Model, slot
from fiohost.motor.simulate import Start

MAX_ITERATIONS = 40
# A step that promises less than this share of what the tolerance asks for is not tried.
PROMISED = 0.1
# Windows are fitted along their tangent; to a tolerance below this one, with exact derivatives in the end.
ALONG_TANGENT = 9e-6
PLAY_ROUNDS = 2
# Where steps left no more than this share of the squared error, windows are begun anew.
MOVED_FAR = 0.9
# The longest step of one iteration shrinks so with every attempt that does not pay, for a start by its reach.
REACH_SHRINKS = 0.3


@dataclass(frozen=True)
class Fit:
    """A fitted model with what is needed to judge it.

    ``residuals`` and ``jacobians`` hold one array a record, (n) and (n, len(names)), in windows of the samples that are
    looked at: measured minus simulated, and the
    derivative of the simulation by each free parameter with the initial state projected out, both times the records'
    weights where whole runs are fitted. ``nuisances`` are the derivatives by the initial state, ``starts`` the records'
    initial angles and speeds, ``samples`` the number of readings, weighted likewise. ``windows`` says what was fitted.
    """

    model: Model
    names: tuple[str, ...]
    cost: float
    residuals: tuple[np.ndarray, ...]
    jacobians: tuple[np.ndarray, ...]
    nuisances: tuple[np.ndarray, ...]
    starts: tuple[Start, ...]
    converged: bool
    samples: float
    windows: bool = False

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.cost / max(self.samples, 1.0)))

    def errors(self, records: Sequence[Record]) -> list[np.ndarray]:
        """Measured minus simulated (n) of each of the ``records`` that were fitted as whole runs, unweighted."""
        return [e / r.weights for e, r in zip(self.residuals, records, strict=True)]


@dataclass
class _Point:
    """Parameter values and initial states at which the simulation stands; ``begins`` are the states in which each
    record's windows begin there.
    """

    p: np.ndarray
    starts: list[Start]
    begins: list[Begun] = field(default_factory=list)


class _Solved(NamedTuple):
    """Where a fit came to, with arrays as in ``Fit``, its squared error, and whether it converged."""

    point: _Point
    residuals: list[np.ndarray]
    jacobians: list[np.ndarray]
    nuisances: list[np.ndarray]
    cost: float
    converged: bool


class _Problem:
    """The residuals of a set of records under one model structure, by parameters of the model."""

    def __init__(self, model: Model, records: Sequence[Record], windows: bool) -> None:
        self.model = model
        self.records = records
        self.windows = windows
        self.base = Flat.of(model)
        self.names, phased = tuple(model.free()), model.phased()
        self.slots = np.array([slot(n) for n in self.names], dtype=np.int64)
        parameters = [model.parameter(n) for n in self.names]
        self.lower = np.array([q.lower for q in parameters])
        self.upper = np.array([q.upper for q in parameters])
        # A size that swings has no sign: below zero it is another phase, else no phase would lead on from zero.
        phases = [phased.get(n) for n in self.names]
        self.phases = np.array([slot(p) if p in self.names else -1 for p in phases], dtype=np.int64)
        self.lower = np.where(self.phases >= 0, -self.upper, self.lower)
        self.steps = np.array([q.step for q in parameters])
        self.relative = np.array([q.relative_step for q in parameters])

    def flat(self, p: np.ndarray) -> Flat:
        return self.base.at(p)

    def upright(self, solved: _Solved) -> _Solved:
        """A solution with what swings above zero: below it, by half a turn of its phase."""
        p = solved.point.p.copy()
        below = (self.phases >= 0) & (p[self.slots] < 0.0)
        if not below.any():
            return solved
        p[self.phases[below]] += 180.0
        p[self.slots[below]] *= -1.0
        signs = np.where(below, -1.0, 1.0)
        return solved._replace(point=replace(solved.point, p=p), jacobians=[j * signs for j in solved.jacobians])

    def residuals(self, point: _Point, most: float = np.inf) -> tuple[list[np.ndarray], float]:
        """Residuals, and their squared error: infinite once beyond ``most``, records left are not asked then."""
        flat, cost = self.flat(point.p), 0.0
        near: list[Begun | None] = [*point.begins] or [None] * len(point.starts)
        found: list[np.ndarray] = []
        begins: list[Begun] = []
        for record, start, begun in zip(self.records, point.starts, near, strict=True):
            if self.windows:
                residual, begun = windowed(record, flat, start, near=begun)
                begins.append(begun)
            else:
                residual = errors(record, flat, start)
            found.append(residual)
            cost += squared([residual])
            if cost > most:
                return found, np.inf
        point.begins = begins
        return found, cost

    def begun_anew(self, point: _Point, residuals: list[np.ndarray]) -> tuple[_Point, list[np.ndarray]]:
        """The same point, the windows of each record begun from its free run where they then leave less."""
        anew = _Point(point.p, point.starts)
        found, _ = self.residuals(anew)
        best = [float(new @ new) < float(old @ old) for new, old in zip(found, residuals, strict=True)]
        begins = [n if b else o for n, o, b in zip(anew.begins, point.begins, best, strict=True)]
        kept = [n if b else o for n, o, b in zip(found, residuals, best, strict=True)]
        return replace(point, begins=begins), kept

    def columns(
        self, record: Record, start: Start, point: _Point, residual: np.ndarray, tangent: Tangent | None
    ) -> np.ndarray:
        """Derivative (n, parameters) of what is simulated, one finite difference each, turned inward at a bound."""
        values = point.p[self.slots]
        moved: list[tuple[Flat, float]] = []
        for j, where in enumerate(self.slots):
            step = self.steps[j] * (max(abs(values[j]), 1e-9) if self.relative[j] else 1.0)
            if values[j] + step > self.upper[j]:
                step = -step
            p = point.p.copy()
            p[where] += step
            moved.append((self.flat(p), step))
        if tangent is not None:
            return tangent.by_each([(flat, start, step) for flat, step in moved])
        out = np.empty((len(residual), len(moved)))
        for j, (flat, step) in enumerate(moved):
            out[:, j] = (residual - errors(record, flat, start, self.windows)) / step
        return out

    def linearise(
        self, point: _Point, residuals: list[np.ndarray], exactly: bool
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Columns by parameter, and by the initial states; those of windows along their tangent unless ``exactly``."""
        flat = self.flat(point.p)
        jacobians, nuisances = [], []
        for i, (record, start, residual) in enumerate(zip(self.records, point.starts, residuals, strict=True)):
            tangent = Tangent(record, flat, start, point.begins[i]) if self.windows and not exactly else None
            jacobians.append(self.columns(record, start, point, residual, tangent))
            nuisances.append(start_columns(record, flat, start, residual, self.windows, tangent))
        return jacobians, nuisances


def project(columns: np.ndarray, nuisance: np.ndarray) -> np.ndarray:
    """Columns (n, k) with their part along the nuisance columns (n, q) taken out."""
    if nuisance.shape[1] == 0:
        return columns
    basis, _ = np.linalg.qr(nuisance)
    return np.asarray(columns - basis @ (basis.T @ columns))


def _solve(problem: _Problem, point: _Point, max_iterations: int, tolerance: float) -> _Solved:
    residuals, cost = problem.residuals(point)
    damping = 1e-4
    converged = False
    exactly, begun = not problem.windows, cost
    jacobians = [np.zeros((len(r), len(problem.slots))) for r in residuals]
    nuisances = [np.empty((len(r), 0)) for r in residuals]
    if not np.isfinite(cost):
        max_iterations = 0
    for _ in range(max_iterations):
        if converged:
            # Windows that begin where steps led from afar may hold to another minimum than those of this model's run.
            if not (problem.windows and cost < MOVED_FAR * begun):
                break
            point, residuals = problem.begun_anew(point, residuals)
            was, cost = cost, squared(residuals)
            converged = was - cost <= tolerance * cost
            if converged:
                break
            begun, damping = cost, 1e-4
        jacobians, nuisances = problem.linearise(point, residuals, exactly)
        gradient = np.zeros(len(problem.slots))
        hessian = np.zeros((len(problem.slots),) * 2)
        parts = []
        nuisance_gain = 0.0
        for residual, columns, nuisance in zip(residuals, jacobians, nuisances, strict=True):
            inner = nuisance.T @ nuisance
            inner += (1e-12 * np.trace(inner) + 1e-200) * np.eye(len(inner)) if len(inner) else 0.0
            cross = nuisance.T @ columns
            pull = nuisance.T @ residual
            eliminate = np.linalg.solve(inner, np.column_stack((cross, pull))) if len(inner) else np.empty((0, 0))
            gradient += columns.T @ residual
            hessian += columns.T @ columns
            if len(inner):
                nuisance_gain += float(pull @ eliminate[:, -1])
                gradient -= cross.T @ eliminate[:, -1]
                hessian -= cross.T @ eliminate[:, :-1]
            parts.append(eliminate)
        values = point.p[problem.slots]
        blocked = ((values <= problem.lower) & (gradient < 0)) | ((values >= problem.upper) & (gradient > 0))
        active = ~blocked & (np.diag(hessian) > 1e-20 * max(cost, 1e-20))
        improved = False
        flat = problem.flat(point.p)
        for attempt in range(8):
            step = np.zeros(len(values))
            if active.any():
                diagonal = np.diag(hessian)[active]
                scale = np.sqrt(diagonal)
                scaled = hessian[np.ix_(active, active)] / np.outer(scale, scale) + damping * np.eye(int(active.sum()))
                try:
                    step[active] = np.linalg.solve(scaled, gradient[active] / scale) / scale
                except np.linalg.LinAlgError:
                    damping = max(damping, 1e-6) * 10.0
                    continue
            moved = np.clip(values + step, problem.lower, problem.upper)
            step = moved - values
            if float(step @ gradient) + nuisance_gain <= PROMISED * tolerance * cost:
                break
            trial = _Point(point.p.copy(), list(point.starts), point.begins)
            trial.p[problem.slots] = moved
            for i, (record, part) in enumerate(zip(problem.records, parts, strict=True)):
                if part.size == 0:
                    continue
                shift = part[:, -1] - part[:, :-1] @ step
                trial.starts[i] = moved_start(
                    record, flat, trial.starts[i], shift, problem.windows, REACH_SHRINKS**attempt
                )
            new_residuals, new_cost = problem.residuals(trial, most=cost)
            if new_cost <= cost:
                improved = True
                break
            damping = max(damping, 1e-6) * 8.0
        if not improved:
            converged = exactly or tolerance > ALONG_TANGENT
            if not converged:
                exactly, damping = True, 1e-4
            continue
        gain = cost - new_cost
        point, residuals, cost = trial, new_residuals, new_cost
        damping = max(damping * 0.15, 1e-9)
        if gain <= tolerance * cost or cost < 1e-18:
            converged = exactly or tolerance > ALONG_TANGENT
            exactly = exactly or not converged
    # Derivatives are those of the last step's beginning: where the fit has converged, the same.
    projected = [project(c, n) for c, n in zip(jacobians, nuisances, strict=True)]
    return _Solved(point, residuals, projected, nuisances, cost, converged)


def _as_model(model: Model, names: Sequence[str], p: np.ndarray) -> Model:
    """The model with fitted values; angles are wrapped into one period."""
    values: dict[str, float | str] = {}
    for name in names:
        parameter = model.parameter(name)
        value = float(p[slot(name)])
        if parameter.period:
            value = (value + 0.5 * parameter.period) % parameter.period - 0.5 * parameter.period
        values[name] = min(max(value, parameter.lower), parameter.upper)
    return model.with_values(values)


def fit(
    model: Model,
    records: Sequence[Record],
    *,
    windows: bool = False,
    starts: Sequence[Start] | None = None,
    max_iterations: int = MAX_ITERATIONS,
    tolerance: float = 1e-7,
    lash: bool = True,
    zeros: bool = True,
) -> Fit:
    """Fit the free parameters of a model to records, from the values it has.

    ``windows`` chooses the one-second cost; ``starts`` are initial states to begin with (else from the first second);
    without ``lash`` the motor stays where in its gap these have it, without ``zeros`` a log's own zero is near where
    they have it. Raises DataError without records.
    """
    if not records:
        raise DataError("there is no log to fit")
    problem = _Problem(model, records, windows)
    given = (
        first_starts(problem.base, records) if starts is None else with_origins(problem.base, records, starts, zeros)
    )
    point = _Point(model.vector(), given)
    solved = _solve(problem, point, max_iterations, tolerance)
    for _ in range(PLAY_ROUNDS if lash and not windows else 0):
        point = solved.point
        play = taken_up_play(problem.flat(point.p), records, point.starts)
        if play == point.starts:
            break
        other = _solve(problem, _Point(point.p, play), max_iterations, tolerance)
        if other.cost >= solved.cost:
            break  # what suits the beginnings of the runs best does not suit the whole of them
        solved = other
    point, residuals, jacobians, nuisances, cost, converged = problem.upright(solved)
    return Fit(
        model=_as_model(model, problem.names, point.p),
        names=problem.names,
        cost=cost,
        residuals=tuple(residuals),
        jacobians=tuple(jacobians),
        nuisances=tuple(nuisances),
        starts=tuple(point.starts),
        converged=converged,
        samples=float(sum(r.edges[-1] if windows else r.weights @ r.weights for r in records)),
        windows=windows,
    )


def best_of(candidates: Sequence[Model], run: Callable[[Model], Fit]) -> Fit:
    """The fit of lowest cost over several starts."""
    return min((run(model) for model in candidates), key=lambda f: f.cost)


def first_guess(model: Model, records: Sequence[Record]) -> Model:
    """Start values of gain and lag from the data: speed over duty at strong commands; the lag is left to
    several starts.
    """
    ratios: list[float] = []
    for record in records:
        times = record.excitation.times_s
        duty = record.acting_pct
        if record.kind == ANGLE:
            span = max(1, round(0.1 / record.sample_time_s))
            if len(times) <= span:
                continue
            speed = (record.y[span:] - record.y[:-span]) / (times[span:] - times[:-span])
            duty = duty[: len(speed)]
        else:
            speed = record.y
        strong = np.abs(duty) > 0.5 * np.max(np.abs(duty), initial=0.0)
        moving = strong & (np.abs(speed) > 0)
        ratios.extend((np.abs(speed[moving]) / np.abs(duty[moving])).tolist())
    if not ratios:
        raise DataError("no log shows the motor moving under a command: there is nothing to fit")
    gain, of = float(np.percentile(ratios, 75)), model.parameter("linear.gain_deg_s_per_pct")
    if not of.lower <= gain <= of.upper:
        raise DataError(
            f"one percent of the command moves the output by {gain:.3g} deg/s, which no motor does: is the command in "
            "percent of full, and the output in the unit that is said? (scale and unit in the map)"
        )
    return model.with_values({"linear.gain_deg_s_per_pct": gain})


def fit_from_scratch(
    model: Model, records: Sequence[Record], *, keep_start: bool = False, windows: bool = False
) -> Fit:
    """Fit a declared model: gain from the data, several lags, windows first, then whole runs from the best of them
    unless only ``windows`` are asked for.

    ``keep_start`` also tries the model's own values, as when it was read from a file.
    """
    guess = first_guess(model, records)
    starts = [guess.with_values({"linear.tau_s": tau}) for tau in (0.03, 0.1, 0.4)]
    starts = [s for s in starts if "linear.tau_s" not in model.fixed][: 3 if "linear.tau_s" not in model.fixed else 0]
    if keep_start or not starts:
        starts.append(model)
    with threadpool_limits(limits=1, user_api="blas"):  # numpy's own threads on small matrices cost more than they do
        near = best_of(starts, lambda m: fit(m, records, windows=True, max_iterations=15, tolerance=1e-3))
        return near if windows else fit(near.model, records)


def unchanged(
    model: Model,
    records: Sequence[Record],
    *,
    starts: Sequence[Start] | None = None,
    windows: bool = False,
    lash: bool = True,
    zeros: bool = True,
    tolerance: float = 1e-7,
) -> Fit:
    """The figures of a model as it is, nothing estimated but initial states."""
    frozen = replace(model, fixed=frozenset(k for k in model.values))
    return fit(frozen, records, starts=starts, windows=windows, lash=lash, zeros=zeros, tolerance=tolerance)
