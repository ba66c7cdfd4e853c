"""How small the residual could be: replicas of the fitted model through the same sensor, and scatter between
repeats.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.predict import Flat, errors
from fiohost.estimation.record import Record
from fiohost.estimation.repeats import repeats
from fiohost.estimation.solver import project
from fiohost.judging.metrics import Errors, Judgement, judge
from fiohost.judging.replica import Replicas, another_day
from fiohost.judging.settings import FLOOR
from fiohost.motor.model import Model
from fiohost.workers import each


@dataclass(frozen=True)
class Floor:
    """Floor figures of one record: their median over replicas, or the scatter between repeats where that is larger.

    ``draws`` are the judgements of the replicas, from which thresholds are taken; their arrays are dropped.
    """

    errors: Errors
    source: str
    draws: tuple[Judgement, ...]

    @property
    def weighted_square(self) -> float:
        """Squared error of the free run as a fit weighs it, summed up; repeats that scatter more raise it alike."""
        over = self.errors.free_run_rms / max(_median([d.errors for d in self.draws]).free_run_rms, 1e-300)
        return float(np.mean([d.weighed.square for d in self.draws])) * over**2


def _median(draws: Sequence[Errors]) -> Errors:
    """Each figure as half of the draws reach it: one draw of many may err by any size, as where a shaft sticks."""

    def middle(values: Sequence[float | None]) -> float | None:
        known = [v for v in values if v is not None]
        return float(np.median(known)) if known else None

    return Errors(
        free_run_rms=float(np.median([d.free_run_rms for d in draws])),
        window_rms=float(np.median([d.window_rms for d in draws])),
        bin_violation_pct=middle([d.bin_violation_pct for d in draws]),
        fit_pct=middle([d.fit_pct for d in draws]),
        samples=draws[0].samples,
    )


def followed(fitted: Fit, norms: np.ndarray, left: float) -> np.ndarray:
    """Which parameters (k) of a fit follow the data, ``norms`` (k) being those of its derivatives, ``left`` that of
    what it leaves.

    What was searched stays, as a moment was, and what is at its bound: its derivative says nothing of how far off it
    is. So does a level that no reading hangs on: its derivative is that of rounding, which leads anywhere.
    """
    parameters = [fitted.model.parameter(name) for name in fitted.names]
    lower, upper = np.array([(q.lower, q.upper) for q in parameters]).reshape(-1, 2).T
    values = np.array([fitted.model.number(name) for name in fitted.names])
    searched = np.array([q.is_searched for q in parameters], dtype=bool)
    seen = (upper - lower) * norms > FLOOR.seen * left
    return np.flatnonzero(~searched & (lower < values) & (values < upper) & seen)


class Refits:
    """The models that fits to replicas of a fit's data would give, by one step of each.

    Counts pull an estimate a little off the truth, and a fitted model is judged with that error in it. A step is
    halved while it does not pay: no fit to a replica leaves more of it than the model that it was drawn from.
    """

    def __init__(self, fitted: Fit, left: Callable[[Model], list[np.ndarray]]) -> None:
        """``left`` says what a model leaves of each record that was fitted (n each), as the fit weighs it."""
        self.fitted, self.left = fitted, left
        parameters = [fitted.model.parameter(name) for name in fitted.names]
        self.lower, self.upper = np.array([(q.lower, q.upper) for q in parameters]).reshape(-1, 2).T
        self.values = np.array([fitted.model.number(name) for name in fitted.names])
        self.hessian = np.sum([c.T @ c for c in fitted.jacobians], axis=0)

    @cached_property
    def as_fitted(self) -> list[np.ndarray]:
        """What the fitted model leaves of each record (n)."""
        return self.left(self.fitted.model)

    def _pays(self, model: Model, noises: Sequence[np.ndarray]) -> bool:
        """Whether a model leaves no more of a replica than the fitted one, each with initial states of its own."""
        squares, parts = np.zeros(2), zip(noises, self.left(model), self.as_fitted, self.fitted.nuisances, strict=True)
        with np.errstate(over="ignore", invalid="ignore"):  # a model that runs away pays nothing
            for noise, left, was, own in parts:
                squares += np.sum(project(np.column_stack((noise, noise + left - was)), own) ** 2, axis=0)
        return bool(squares[1] <= squares[0])

    def model(self, noises: Sequence[np.ndarray]) -> Model:
        """That of one replica, which leaves ``noises`` (n, one a record) of the fitted model."""
        norms = np.sqrt(np.diag(self.hessian))
        which = followed(self.fitted, norms, float(np.sqrt(sum(float(n @ n) for n in noises))))
        if not len(which):
            return self.fitted.model
        gradient = np.sum([c.T @ n for c, n in zip(self.fitted.jacobians, noises, strict=True)], axis=0)[which]
        scale = np.maximum(norms[which], 1e-150)
        scaled = self.hessian[np.ix_(which, which)] / np.outer(scale, scale)
        step = np.linalg.pinv(scaled, rcond=1e-8) @ (gradient / scale) / scale
        names = [self.fitted.names[i] for i in which]
        for share in FLOOR.step_shares:
            moved = np.clip(self.values[which] + share * step, self.lower[which], self.upper[which])
            model = self.fitted.model.with_values(dict(zip(names, moved.tolist(), strict=True)))
            if self._pays(model, noises):
                return model
        return self.fitted.model


def replica_models(
    fitted: Fit,
    records: Sequence[Record],
    rng: np.random.Generator,
    count: int = FLOOR.replicas,
    *,
    anywhere: bool = False,
) -> list[Model]:
    """Models (count) as they would be fitted to replicas of the records that were fitted.

    ``anywhere`` lets the shaft stand anywhere within its count: how estimates scatter from one bench to the next.
    """
    replicas = replicas_of(fitted, records, anywhere=anywhere)

    def left(model: Model) -> list[np.ndarray]:
        flat = Flat.of(model)
        return [errors(r, flat, s, fitted.windows) for r, s in zip(records, fitted.starts, strict=True)]

    refits = Refits(fitted, left)
    return [refits.model(replica_errors(fitted, replicas, rng)) for _ in range(count)]


def refitted_models(fitted: Fit, records: Sequence[Record], rng: np.random.Generator) -> list[Model]:
    """Models fitted to replicas of the windows that were fitted.

    Where a torque decides in which windows a shaft sticks, the error is no smooth function of what decides with it, as
    friction: estimates scatter by two or three times what one step from the fit says.
    """
    norms = np.sqrt(np.sum([np.sum(c**2, axis=0) for c in fitted.jacobians], axis=0))
    moving = {fitted.names[i] for i in followed(fitted, norms, float(np.sqrt(fitted.cost)))}
    held = replace(fitted.model, fixed=fitted.model.fixed | (set(fitted.names) - moving))
    replicas = replicas_of(fitted, records, anywhere=True)

    def refitted(rng: np.random.Generator) -> Model:
        days = another_day(records, rng)
        drawn = [replace(day, y=r.draw(rng, day)) for r, day in zip(replicas, days, strict=True)]
        steps, tolerance = FLOOR.refit
        return fit(
            held,
            drawn,
            windows=True,
            starts=fitted.starts,
            max_iterations=steps,
            tolerance=tolerance,
            zeros=False,
        ).model

    return each(refitted, rng.spawn(FLOOR.replicas))


def replicas_of(fitted: Fit, records: Sequence[Record], *, anywhere: bool = False) -> list[Replicas]:
    """Replicas of each of the records that were fitted; ``anywhere`` as for ``replica_models``."""
    known: Sequence[np.ndarray | None] = [None] * len(records)
    if not anywhere and not fitted.windows:  # windows do not say where in its count a whole run stands
        known = fitted.errors(records)
    return [Replicas(r, fitted.model, s, e) for r, s, e in zip(records, fitted.starts, known, strict=True)]


def replica_errors(
    fitted: Fit,
    replicas: Sequence[Replicas],
    rng: np.random.Generator,
    *,
    open_noise: bool = True,
    open_runs: bool = False,
) -> list[np.ndarray]:
    """What a fitted model would leave of one draw of its own readings, for each record, as the fit weighs it."""
    days = another_day([r.record for r in replicas], rng, open_noise=open_noise, open_runs=open_runs)
    return [r.left(rng, fitted.windows, day) for r, day in zip(replicas, days, strict=True)]


def replica_floor(
    record: Record,
    model: Model,
    judgement: Judgement,
    models: Sequence[Model],
    rng: np.random.Generator,
    before: tuple[Judgement, ...] = (),
) -> Floor:
    """Floor of a record: replicas of the judged model, each judged by the model that would be fitted to it; and those
    drawn ``before``.
    """
    start, none = judgement.start, np.empty(0)
    replicas = Replicas(record, model, start, judgement.free_residual)

    def draw(judged_by: Model) -> Judgement:
        """One replica judged, without its arrays: of a long record, those of all would fill the memory."""
        (other,) = another_day([record], rng)
        found = judge(record, judged_by, replicas.draw(rng, other), near=start, begun=replicas.begun)
        return replace(found, simulated=none, free_residual=none, window_residual=none)

    draws = (*before, *(draw(m) for m in models))
    return Floor(_median([d.errors for d in draws]), "replicas", draws)


def _detrended(values: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Values (n) with offset and slope taken out of every window, as free angle and speed would."""
    out = np.empty_like(values)
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        x = np.linspace(-1.0, 1.0, b - a) if b - a > 1 else np.zeros(1)
        piece = values[a:b] - values[a:b].mean()
        norm = float(x @ x)
        out[a:b] = piece - (float(x @ piece) / norm if norm > 0 else 0.0) * x
    return out


def scatter(residuals: Sequence[np.ndarray], edges: np.ndarray) -> tuple[float, float]:
    """Free-run and window rms of what differs between the residuals (n each) of repeats of one experiment.

    Residuals, not outputs: repeats that begin at other angles differ in ways that the model knows.
    """
    runs = np.array(residuals)
    correction = np.sqrt(len(runs) / (len(runs) - 1.0))
    deviations = (runs - runs.mean(axis=0)) * correction
    free = deviations - deviations.mean(axis=1, keepdims=True)
    windows = np.array([_detrended(d, edges) for d in deviations])
    return float(np.sqrt(np.mean(free**2))), float(np.sqrt(np.mean(windows**2)))


def floors(
    records: Sequence[Record],
    model: Model,
    judgements: Sequence[Judgement],
    models: Sequence[Model],
    rng: np.random.Generator,
    before: Sequence[Floor] = (),
    asked: Collection[str] | None = None,
) -> list[Floor]:
    """Floors of records by replicas of a model, as judged by ``models``, and by those of floors ``before`` these; of
    records that are not ``asked`` by the latter alone. The scatter of repeats counts where larger.
    """
    rngs, earlier = rng.spawn(len(records)), [f.draws for f in before] or [()] * len(records)

    def one(i: int) -> Floor:
        drawn = models if asked is None or records[i].name in asked else ()
        return replica_floor(records[i], model, judgements[i], drawn, rngs[i], earlier[i])

    found = each(one, range(len(records)))
    for group in repeats(records):
        free, windows = scatter([judgements[i].free_residual for i in group], records[group[0]].windows)
        for i in group:
            was = found[i].errors
            if windows > 1.1 * was.window_rms or free > 1.1 * was.free_run_rms:
                larger = replace(was, free_run_rms=max(free, was.free_run_rms), window_rms=max(windows, was.window_rms))
                found[i] = Floor(larger, "repeats", found[i].draws)
    return found
