"""Levenberg-Marquardt over all records at once, the initial states of each eliminated (variable projection).

What is fitted are residuals in windows or in whole runs; how they come about only ``predict`` and ``starts`` know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from fiohost.estimation.predict import Begun, Flat, errors, squared, windowed
from fiohost.estimation.record import Record
from fiohost.estimation.settings import SETTINGS
from fiohost.estimation.starts import moved_start, start_columns, within_reach
from fiohost.estimation.tangent import Tangent
from fiohost.motor.model import Model, slot
from fiohost.motor.simulate import Start


@dataclass
class Point:
    """Parameter values and initial states at which the simulation stands; ``begins`` are the states in which each
    record's windows begin there.
    """

    p: np.ndarray
    starts: list[Start]
    begins: list[Begun] = field(default_factory=list)


class Solved(NamedTuple):
    """Where a fit came to, with arrays as in ``Fit``, its squared error, and whether it converged."""

    point: Point
    residuals: list[np.ndarray]
    jacobians: list[np.ndarray]
    nuisances: list[np.ndarray]
    cost: float
    converged: bool


class Problem:
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
        self.ragged = np.array([q.ragged for q in parameters], dtype=bool)

    def flat(self, p: np.ndarray) -> Flat:
        return self.base.at(p)

    def upright(self, solved: Solved) -> Solved:
        """A solution with what swings above zero: below it, by half a turn of its phase."""
        p = solved.point.p.copy()
        below = (self.phases >= 0) & (p[self.slots] < 0.0)
        if not below.any():
            return solved
        p[self.phases[below]] += 180.0
        p[self.slots[below]] *= -1.0
        signs = np.where(below, -1.0, 1.0)
        return solved._replace(point=replace(solved.point, p=p), jacobians=[j * signs for j in solved.jacobians])

    def residuals(self, point: Point, most: float = np.inf) -> tuple[list[np.ndarray], float]:
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

    def begun_anew(self, point: Point, residuals: list[np.ndarray]) -> tuple[Point, list[np.ndarray]]:
        """The same point, the windows of each record begun from its free run where they then leave less."""
        anew = Point(point.p, point.starts)
        found, _ = self.residuals(anew)
        best = [float(new @ new) < float(old @ old) for new, old in zip(found, residuals, strict=True)]
        begins = [n if b else o for n, o, b in zip(anew.begins, point.begins, best, strict=True)]
        kept = [n if b else o for n, o, b in zip(found, residuals, best, strict=True)]
        return replace(point, begins=begins), kept

    def columns(
        self, record: Record, start: Start, point: Point, residual: np.ndarray, tangent: Tangent | None
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
        self, point: Point, residuals: list[np.ndarray], exactly: bool
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


class _Followed(NamedTuple):
    """A record's normal equations by parameters, its start following them: ``gradient`` (k), ``hessian`` (k, k). The
    start's shift (q) is ``alone`` less ``along`` (q, k) times their step.
    """

    gradient: np.ndarray
    hessian: np.ndarray
    along: np.ndarray
    alone: np.ndarray


class _Part(NamedTuple):
    """What a record says of a step: ``gradient`` (k) and ``hessian`` (k, k) by parameters; ``pull`` (q) and ``inner``
    (q, q) by its start; ``cross`` (q, k) by both.
    """

    gradient: np.ndarray
    hessian: np.ndarray
    pull: np.ndarray
    inner: np.ndarray
    cross: np.ndarray

    @classmethod
    def of(cls, residual: np.ndarray, columns: np.ndarray, nuisance: np.ndarray) -> _Part:
        inner = nuisance.T @ nuisance
        inner += (1e-12 * np.trace(inner) + 1e-200) * np.eye(len(inner))
        return cls(columns.T @ residual, columns.T @ columns, nuisance.T @ residual, inner, nuisance.T @ columns)

    def followed(self, held: np.ndarray, at: np.ndarray) -> _Followed:
        """The equations with the start eliminated, what of its shift is ``held`` (q) being ``at`` (q)."""
        free, alone, along = ~held, np.where(held, at, 0.0), np.zeros_like(self.cross)
        gradient, hessian = self.gradient - self.cross.T @ alone, self.hessian
        if free.any():
            pull, cross = self.pull[free] - self.inner[free] @ alone, self.cross[free]
            follows = np.linalg.solve(self.inner[np.ix_(free, free)], np.column_stack((cross, pull)))
            along[free], alone[free] = follows[:, :-1], follows[:, -1]
            gradient, hessian = gradient - cross.T @ alone[free], hessian - cross.T @ along[free]
        return _Followed(gradient, hessian, along, alone)


class _Equations(NamedTuple):
    """The normal equations of all records by parameters: ``gradient`` (k) and ``hessian`` (k, k)."""

    gradient: np.ndarray
    hessian: np.ndarray

    @classmethod
    def of(cls, parts: Sequence[_Followed]) -> _Equations:
        return cls(np.sum([p.gradient for p in parts], axis=0), np.sum([p.hessian for p in parts], axis=0))

    def step(self, active: np.ndarray, damping: float) -> np.ndarray | None:
        """The damped step (k) of the parameters that are ``active``; None where the equations are singular."""
        step = np.zeros(len(self.gradient))
        if active.any():
            scale = np.sqrt(np.diag(self.hessian)[active])
            scaled = self.hessian[np.ix_(active, active)] / np.outer(scale, scale)
            scaled = scaled + damping * np.eye(int(active.sum()))
            try:
                step[active] = np.linalg.solve(scaled, self.gradient[active] / scale) / scale
            except np.linalg.LinAlgError:
                return None
        return step


def _stepped(
    problem: Problem,
    point: Point,
    parts: Sequence[_Part],
    cost: float,
    damping: float,
    least: float,
    stays: np.ndarray | None = None,
) -> tuple[tuple[Point, list[np.ndarray], float] | None, float]:
    """The point that a step leads to from one of squared error ``cost``, with its residuals and error, None where no
    step pays or promises ``least``; and the damping at which that was seen. A parameter that ``stays`` (k) takes none.

    A start that is not to go as far as it would is held where it may go, and the parameters step as suits it there:
    else they would go ahead of it, and no step would pay.
    """
    values, flat = point.p[problem.slots], problem.flat(point.p)
    freely = [p.followed(np.zeros(len(p.pull), dtype=bool), p.pull) for p in parts]
    by_starts = sum(float(p.pull @ f.alone) for p, f in zip(parts, freely, strict=True))
    free = _Equations.of(freely)

    def moved_by(equations: _Equations) -> np.ndarray | None:
        gradient = equations.gradient
        blocked = ((values <= problem.lower) & (gradient < 0)) | ((values >= problem.upper) & (gradient > 0))
        active = ~blocked & (np.diag(equations.hessian) > 1e-20 * max(cost, 1e-20))
        active = active if stays is None else active & ~stays
        step = equations.step(active, damping)
        return None if step is None else np.clip(values + step, problem.lower, problem.upper)

    def shifts(follow: Sequence[_Followed], moved: np.ndarray, share: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """How far each start would go, and how far it may."""
        wanted = [f.alone - f.along @ (moved - values) for f in follow]
        each = zip(problem.records, point.starts, wanted, strict=True)
        return [(w, within_reach(r, flat, start, w, problem.windows, share)) for r, start, w in each]

    for attempt in range(SETTINGS.attempts):
        moved = moved_by(free)
        if moved is None:
            damping = max(damping, 1e-6) * 10.0
            continue
        if float((moved - values) @ free.gradient) + by_starts <= least:
            break
        share, follow = SETTINGS.reach_shrinks**attempt, freely
        far = [(wanted != may, may) for wanted, may in shifts(freely, moved, share)]
        if any(held.any() for held, _ in far):
            follow = [p.followed(*at) if at[0].any() else f for p, f, at in zip(parts, freely, far, strict=True)]
            beside = moved_by(_Equations.of(follow))
            moved = values if beside is None else beside
        trial = Point(point.p.copy(), list(point.starts), point.begins)
        trial.p[problem.slots] = moved
        for i, (record, (_, may)) in enumerate(zip(problem.records, shifts(follow, moved, share), strict=True)):
            if len(may):
                trial.starts[i] = moved_start(record, flat, trial.starts[i], may, problem.windows)
        residuals, new = problem.residuals(trial, most=cost)
        if new <= cost:
            return (trial, residuals, new), damping
        damping = max(damping, 1e-6) * 8.0
    return None, damping


def solve(problem: Problem, point: Point, max_iterations: int, tolerance: float) -> Solved:
    """The least squared error downhill of a point, until a step takes no more than a share ``tolerance`` of it."""
    residuals, cost = problem.residuals(point)
    damping = 1e-4
    converged = False
    exactly, begun = not problem.windows, cost
    jacobians = [np.zeros((len(r), len(problem.slots))) for r in residuals]
    nuisances = [np.empty((len(r), 0)) for r in residuals]
    for _ in range(max_iterations if np.isfinite(cost) else 0):
        if converged:
            # Windows that begin where steps led from afar may hold to another minimum than those of this model's run.
            if not (problem.windows and cost < SETTINGS.moved_far * begun):
                break
            point, residuals = problem.begun_anew(point, residuals)
            was, cost = cost, squared(residuals)
            converged = was - cost <= tolerance * cost
            if converged:
                break
            begun, damping = cost, 1e-4
        jacobians, nuisances = problem.linearise(point, residuals, exactly)
        parts = [_Part.of(*of) for of in zip(residuals, jacobians, nuisances, strict=True)]
        begun_with, least = damping, SETTINGS.promised * tolerance * cost
        better, damping = _stepped(problem, point, parts, cost, damping, least)
        if better is None and problem.ragged.any():
            # Across a jump of the error a derivative says nothing: the others step without it.
            better, damping = _stepped(problem, point, parts, cost, begun_with, least, problem.ragged)
        if better is None:
            converged = exactly or tolerance > SETTINGS.along_tangent
            if not converged:
                exactly, damping = True, 1e-4
            continue
        was = cost
        point, residuals, cost = better
        damping = max(damping * 0.15, 1e-9)
        if was - cost <= tolerance * cost or cost < 1e-18:
            converged = exactly or tolerance > SETTINGS.along_tangent
            exactly = exactly or not converged
    # Derivatives are those of the last step's beginning: where the fit has converged, the same.
    projected = [project(c, n) for c, n in zip(jacobians, nuisances, strict=True)]
    return Solved(point, residuals, projected, nuisances, cost, converged)
