"""A model fitted to windows whitened by the noise that it leaves: the two settle on each other.

Generalised least squares over one-second windows whose angle and speed are free, the covariance from the residuals of
the fit before (iteratively reweighted, as in Carroll and Ruppert 1988): its cost is a deviance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiohost.discover.evidence import whitened_deviance
from fiohost.discover.logs.movement import at_rest, coasting, movement, settling_s, simulated_in_windows, standing
from fiohost.discover.settings import SETTINGS
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.predict import Flat, windowed
from fiohost.estimation.record import Record
from fiohost.estimation.starts import free_spans
from fiohost.estimation.tangent import Tangent
from fiohost.judging.replica import Replicas, another_day
from fiohost.judging.stage import Stage
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.covariance import MEAN_SPEED, Movement
from fiohost.noise.disturbance import Disturbance
from fiohost.noise.estimate import NONE, Noise, estimate
from fiohost.noise.likelihood import Group, Motor, pieces
from fiohost.noise.runs import (
    NO_PULL,
    NO_SCATTER,
    Own,
    Pull,
    RunToRun,
    centred,
    each_alone,
    estimate_runs,
    growth,
    likeliest,
    run_of,
    varied,
)
from fiohost.noise.settings import SETTINGS as NOISE_SETTINGS
from fiohost.noise.whiten import Whitener, is_white, unevenness
from fiohost.workers import each

# A tolerance within which no step is worth taking.
ENDLESS = 1e30

WHITENING = SETTINGS.whitening


@dataclass(frozen=True)
class Settled:
    """A model fitted to windows of ``records``, whitened by the ``noise`` that it leaves, the shaft ``moving``
    so; ``bare`` is its fit to windows as they are.
    """

    fit: Fit
    bare: Fit
    records: tuple[Record, ...]
    noise: Noise
    moving: tuple[Movement, ...]

    @property
    def deviance(self) -> float:
        """-2 log restricted likelihood, but for a constant of the windows and of where the shaft stands."""
        weights = sum(r.disturbance.log_determinant for r in self.records if r.disturbance is not None)
        return whitened_deviance(self.fit) + weights + freedom(self.fit, self.records)


def freedom(found: Fit, records: Sequence[Record]) -> float:
    """What it costs a fit in windows that each record's warmth and own zero are free: both integrated out (Laplace), as
    what differs between runs is. Else a warmth of each run's own would stand for a gain that scatters.
    """
    flat, cost = Flat.of(found.model), 0.0
    for record, columns in zip(records, found.nuisances, strict=True):
        scaled = columns * free_spans(record, flat, columns.shape[1])
        cost += float(np.linalg.slogdet(np.eye(columns.shape[1]) + scaled.T @ scaled)[1])
    return cost


def motor_of(record: Record, model: Model) -> Motor:
    """The model's motor as a torque meets it, and the record's sensor; numbers rounded, so that work on them serves
    again.
    """
    gain, tau_s = model.number("linear.gain_deg_s_per_pct"), settling_s(model)
    kind, quantum = (MEAN_SPEED, record.average.quantum) if record.average else (record.kind, record.quantum)
    return Motor(float(f"{gain:.3g}"), float(f"{tau_s:.3g}"), kind, quantum, record.sample_time_s)


def movements(records: Sequence[Record], model: Model, starts: Sequence[Start]) -> list[Movement]:
    """How a model's shaft moves in the windows of each record, nowhere at rest."""
    return each(lambda i: movement(records[i], model, starts[i]), range(len(records)))


def noise_of(
    model: Model,
    starts: Sequence[Start],
    records: Sequence[Record],
    runs: RunToRun = NO_SCATTER,
    moves: Sequence[Movement] = (),
) -> Noise:
    """The noise that a fitted model leaves in windows of records, what differs between ``runs`` taken out; ``moves``
    where it is known how its shaft does.
    """
    found: list[Group] = []
    for record, start, path in zip(records, starts, moves or movements(records, model, starts), strict=True):
        own = varied(model, runs.by_run.get(run_of(record.name), np.zeros(3)))
        residual, speed = simulated_in_windows(record, own, start)
        motor = motor_of(record, model)
        if record.average:
            residual = record.average.undone(residual, record.windows[:-1])
        driven = np.where(coasting(record), 0.0, speed)
        found += pieces(residual, driven, path.lag_s, record.windows, motor, run_of(record.name))
    declared = {r.noise_rms for r in records}
    noise = estimate(found, sensor=declared.pop() if len(declared) == 1 else None)
    return replace(noise, step_s=records[0].sample_time_s) if records[0].kind == MEAN_SPEED else noise


def run_columns(record: Record, model: Model, start: Start) -> np.ndarray:
    """Derivatives (n, 3) of what a record's windows show, as they are whitened, by what may differ between runs."""
    flat = Flat.of(model)
    tangent = Tangent(record, flat, start, windowed(record, flat, start)[1])
    steps = np.diag(WHITENING.run_steps)
    return np.column_stack([tangent.by(Flat.of(varied(model, s)), start, float(s.sum())) for s in steps])


def around_runs(
    found: Fit, records: Sequence[Record], runs: RunToRun = NO_SCATTER
) -> tuple[list[np.ndarray], dict[str, Pull]]:
    """Around what is each of the ``runs``' own: derivatives (n, 3) by it of each record's (whitened) windows, and how
    what a fit leaves there pulls at it, by run.
    """
    flat, columns, pulls = Flat.of(found.model), list[np.ndarray](), dict[str, Pull]()
    for record, start in zip(records, found.starts, strict=True):
        name, disturbance = run_of(record.name), record.disturbance or Disturbance(NONE)
        values = runs.by_run.get(name, np.zeros(3))
        near = replace(record, disturbance=replace(disturbance, own=Own.alone(values, record.edges[-1])))
        by = run_columns(near, found.model, start) / growth(values)
        left = windowed(near, flat, start)[0] + by @ values
        columns.append(by)
        with np.errstate(over="ignore", invalid="ignore"):  # a model that runs away
            pulls[name] = pulls.get(name, NO_PULL) + Pull(by.T @ by, by.T @ left)
    return columns, pulls


def with_runs(
    found: Fit, records: Sequence[Record], noise: Noise, near: RunToRun
) -> tuple[Model, Noise, tuple[Record, ...]]:
    """The noise with what differs from run to run, the whitened records weighed by it too, and the model of the runs'
    mean; it is taken for linear ``near`` what was found to be each run's own before.
    """
    columns, pulls = around_runs(found, records, near)
    runs = estimate_runs(pulls)
    if not runs.known:
        return found.model, replace(noise, runs=runs), tuple(records)
    runs, mean = centred(runs, pulls)
    noise = replace(noise, runs=runs)
    return varied(found.model, mean), noise, weighed(records, noise, [by * (1.0 + mean) for by in columns])


def with_scatter(found: Fit, records: Sequence[Record], noise: Noise) -> tuple[Record, ...]:
    """Whitened records weighed by what differs between runs too, which scatters as the ``noise`` says."""
    columns, pulls = around_runs(found, records, noise.runs)
    own = {name: likeliest(pull, noise.runs.sd) for name, pull in pulls.items()}
    return weighed(records, replace(noise, runs=replace(noise.runs, by_run=own)), columns)


def weighed(records: Sequence[Record], noise: Noise, columns: Sequence[np.ndarray]) -> tuple[Record, ...]:
    """Whitened records with what is their run's own, by their ``columns`` (n, 3 each)."""
    found = []
    for record, by in zip(records, columns, strict=True):
        assert record.disturbance is not None
        own = Own.of(noise.runs.by_run[run_of(record.name)], by, noise.runs.sd)
        found.append(replace(record, disturbance=replace(record.disturbance, noise=noise_in(record, noise), own=own)))
    return tuple(found)


def with_noise(records: Sequence[Record], model: Model, noise: Noise, moving: Sequence[Movement]) -> tuple[Record, ...]:
    """The records with their windows whitened by a noise; what differs between runs is left as it is."""
    found = []
    for record, moves in zip(records, moving, strict=True):
        times, here = record.excitation.times_s, noise_in(record, noise)
        whitener = Whitener(
            times, moves, record.weights, *record.looked_at, motor_of(record, model), here, record.average
        )
        found.append(replace(record, disturbance=Disturbance(here, whitener)))
    return tuple(found)


def drawing(records: Sequence[Record], noise: Noise) -> list[Record]:
    """The records with their bootstrap samples drawn with a noise, their windows as they are."""
    return [replace(r, disturbance=Disturbance(noise_in(r, noise))) for r in records]


def noise_in(record: Record, noise: Noise) -> Noise:
    """A noise as one record has it, each of its readings."""
    return noise.of(run_of(record.name)).at(record.sample_time_s)


def plain(records: Sequence[Record]) -> list[Record]:
    """The records with their windows as they are."""
    return [replace(r, disturbance=None) for r in records]


def settle(
    found: Fit,
    records: Sequence[Record],
    stands: Sequence[np.ndarray] | None = None,
    rounds: int = WHITENING.rounds,
    bare_first: bool = True,
) -> Settled:
    """Carry a fit on to windows whitened by what it leaves, in turns; ``stands`` (n each) is where the shaft does,
    where another model's is to be kept, not ``bare_first`` where the model comes from whitened windows already.
    """
    bare = plain(records)
    most, tolerance = (20, 1e-4) if bare_first else (1, ENDLESS)
    fitted = plainly = fit(
        found.model, bare, windows=True, starts=found.starts, max_iterations=most, tolerance=tolerance, zeros=False
    )
    paths = movements(bare, fitted.model, fitted.starts)
    moves: tuple[Movement, ...] = ()
    whitened, noise, alone = tuple(bare), NONE, NO_SCATTER
    several = len({run_of(r.name) for r in records}) >= NOISE_SETTINGS.least_runs
    best: Settled | None = None
    for turn in range(rounds):
        if several:  # nothing shrunk: what is left of how runs differ would be taken for a slow torque
            alone = each_alone(around_runs(fitted, bare, alone)[1])
        was, noise = noise, noise_of(fitted.model, fitted.starts, bare, alone, paths)
        if turn > 0 and not several and noise.near(was, WHITENING.settled):
            noise = was
            break
        if not moves:
            if stands is None:
                rms = noise.torque_pct.value
                stands = [standing(r, fitted.model, s, rms) for r, s in zip(bare, fitted.starts, strict=True)]
            moves = tuple(map(at_rest, paths, stands))
        whitened, model = with_noise(bare, fitted.model, noise, moves), fitted.model
        if several:
            model, noise, whitened = with_runs(fitted, whitened, noise, was.runs)
        fitted = fit(
            model, whitened, windows=True, starts=fitted.starts, max_iterations=12, tolerance=1e-5, zeros=False
        )
        before, now = best, Settled(fitted, plainly, whitened, noise, moves)
        if not several or before is None or now.deviance < before.deviance:
            best = now
        if several and before is not None and now.deviance > before.deviance - WHITENING.settled_deviance:
            break  # what runs scatter by and what each has swing about where they settle
    assert best is not None
    return best


def looks_white(stage: Stage, records: Sequence[Record]) -> bool:
    """Whether what a stage leaves in windows is as white as what its own bootstrap samples leave, at 1 %."""
    flat, edges = Flat.of(stage.fit.model), [r.edges for r in records]
    starts = [j.start for j in stage.judgements]
    pairs = zip(records, stage.judgements, strict=True)
    replicas = [Replicas(r, stage.fit.model, j.start, j.free_residual) for r, j in pairs]
    rngs = np.random.default_rng(WHITENING.seed).spawn(WHITENING.draws)

    def draw(rng: np.random.Generator) -> float:
        return unevenness(
            [r.left(rng, True, day) for r, day in zip(replicas, another_day(records, rng), strict=True)], edges
        )

    left = [windowed(r, flat, s)[0] for r, s in zip(records, starts, strict=True)]
    return is_white(unevenness(left, edges), each(draw, rngs))
