"""Simulation-error fit of a model to records.

Two costs share one solver. ``windows`` compares one-second windows whose angle and speed are free: nearly convex,
used to come close. ``free`` compares whole free runs with each record's initial angle and speed free: an order of
magnitude sharper, used to finish. Neither ever differentiates the counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from fiohost.errors import DataError
from fiohost.estimation.record import ANGLE, Record
from fiohost.estimation.settings import SETTINGS
from fiohost.estimation.solver import Point, Problem, solve
from fiohost.estimation.starts import first_starts, taken_up_play, with_origins
from fiohost.motor.model import Model, slot
from fiohost.motor.simulate import Start


@dataclass(frozen=True)
class Fit:
    """A fitted model with what is needed to judge it.

    ``residuals`` and ``jacobians`` hold one array a record, (n) and (n, len(names)), in windows of the samples that are
    looked at: measured minus simulated, and the derivative of the simulation by each free parameter with the initial
    state projected out, both times the records' weights where whole runs are fitted. ``nuisances`` are the derivatives
    by the initial state, ``starts`` the records' initial angles and speeds, ``samples`` the number of readings,
    weighted likewise. ``windows`` says what was fitted.
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
    max_iterations: int = SETTINGS.max_iterations,
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
    problem = Problem(model, records, windows)
    given = (
        first_starts(problem.base, records) if starts is None else with_origins(problem.base, records, starts, zeros)
    )
    point = Point(model.vector(), given)
    solved = solve(problem, point, max_iterations, tolerance)
    for _ in range(SETTINGS.play_rounds if lash and not windows else 0):
        point = solved.point
        play = taken_up_play(problem.flat(point.p), records, point.starts)
        if play == point.starts:
            break
        other = solve(problem, Point(point.p, play), max_iterations, tolerance)
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
