"""How small the residual could be: replicas of the fitted model through the same sensor, and scatter between
repeats.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiohost.discover.metrics import Errors, Judgement, judge, pool, quantise
from fiohost.discover.settings import SETTINGS
from fiohost.discover.workers import each
from fiohost.estimation.fit import Fit
from fiohost.estimation.predict import Flat, errors, free_output, free_states
from fiohost.estimation.record import ANGLE, MEAN_SPEED, Record
from fiohost.estimation.repeats import repeats
from fiohost.motor.effect import Value
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.motor.state import BRAKE, DRIVE, OMEGA, STANDBY
from fiohost.noise.covariance import COASTS, DRIVEN, REST, driven_output
from fiohost.noise.draw import draw_torque
from fiohost.noise.estimate import Noise
from fiohost.noise.runs import varied

FLOOR = SETTINGS.floor


@dataclass(frozen=True)
class Floor:
    """Floor figures of one record: their mean over replicas, or the scatter between repeats where that is larger.

    ``draws`` are the judgements of the replicas, from which thresholds are taken; their arrays are dropped.
    """

    errors: Errors
    source: str
    draws: tuple[Judgement, ...]

    @property
    def weighted_square(self) -> float:
        """Squared error of the free run as a fit weighs it, summed up; repeats that scatter more raise it alike."""
        over = self.errors.free_run_rms / max(_mean([d.errors for d in self.draws]).free_run_rms, 1e-300)
        return float(np.mean([d.weighed.square for d in self.draws])) * over**2


def within_count(record: Record, residual: np.ndarray) -> tuple[float, float]:
    """Bounds of how far the shaft may stand from the model's angle, from the residual (n) of its free run.

    Every reading bounds it to one count, so a model that is true leaves little room (set membership): taken is where
    the fewest readings contradict. Those of a closed loop hunt for an edge between two counts, which no angle drawn at
    random would do. Where the model is too far off to say, any angle within the count is possible.
    """
    count = record.quantum
    if float(np.ptp(residual)) > (1.0 + 2.0 * FLOOR.lost_counts) * count:
        return -0.5 * count, 0.5 * count
    above, below = np.sort(residual - 0.5 * count), np.sort(residual + 0.5 * count)
    # Between two neighbouring bounds the number of readings that contradict does not change.
    edges = np.unique(np.concatenate((above, below)))
    middles = 0.5 * (edges[:-1] + edges[1:])
    against = len(above) - np.searchsorted(above, middles) + np.searchsorted(below, middles)
    best = int(np.argmin(against)) if len(middles) else 0
    middle = float(middles[best]) if len(middles) else float(edges[0])
    room = 0.5 * float(edges[best + 1] - edges[best]) if len(middles) else 0.0
    return middle - room, middle + room


def _shift(record: Record, residual: np.ndarray | None, rng: np.random.Generator) -> float:
    """Where within its count the shaft stood, one draw; how well a fitted model knows it is drawn too."""
    if residual is None:
        return float(rng.uniform(-0.5, 0.5)) * record.quantum
    low, high = within_count(record, residual)
    least = record.quantum * float(np.exp(rng.uniform(*np.log(FLOOR.least_room_counts))))
    return 0.5 * (low + high) + float(rng.uniform(-1.0, 1.0)) * max(0.5 * (high - low), least)


def replica(
    record: Record, model: Model, start: Start, rng: np.random.Generator, residual: np.ndarray | None = None
) -> np.ndarray:
    """One draw (n) of what the sensor would have read had the model been true.

    The angle within its count is unknown, but for what the ``residual`` (n) of the model's free run says of it.
    """
    noise = record.disturbance.noise if record.disturbance else None
    if noise and noise.runs.known:
        model = varied(model, noise.runs.sd * rng.standard_normal(len(noise.runs.sd)))
    flat = Flat.of(model)
    shift = _shift(record, residual, rng) if record.kind == ANGLE else 0.0
    driven = disturbed(record, model, noise, rng) if noise and noise.torque_pct.value > 0.0 else record
    begin = start._replace(angle=start.angle + shift)
    truth = free_output(driven, flat, begin)
    if driven is not record:
        truth = truth + _while_coasting(driven, model, begin, noise, rng)
    if noise and noise.sensor.value > 0.0:
        truth = truth + noise.sensor.value * rng.standard_normal(len(truth))
    if record.kind == ANGLE:
        return quantise(record, truth + 0.5 * record.quantum)
    if record.kind == MEAN_SPEED:
        truth[0] += rng.uniform(0.0, 1.0) * record.quantum  # where within its count the shaft stood
    return quantise(record, truth)


def disturbed(record: Record, model: Model, noise: Noise, rng: np.random.Generator) -> Record:
    """The record with a random torque on its shaft: in percent of duty it adds to what acts, braked or driven."""
    ex = record.excitation
    duties, modes = ex.duties_pct.copy(), ex.modes.copy()
    braked = (modes == BRAKE) if "fast_decay" not in model.effects else np.zeros(len(modes), dtype=bool)
    duties[braked], modes[braked] = 0.0, DRIVE
    driven = modes == DRIVE
    torque = draw_torque(np.append(ex.act_times_s[0] - record.sample_time_s, ex.act_times_s), noise, rng)
    duties[driven] += torque[driven]
    return replace(record, excitation=replace(ex, duties_pct=duties, modes=modes))


def _while_coasting(
    record: Record, model: Model, start: Start, noise: Noise | None, rng: np.random.Generator
) -> np.ndarray:
    """What a random torque adds to the output (n) where the bridge is open: no duty stands for it there."""
    ex = record.excitation
    coasts = ex.modes[np.searchsorted(ex.act_times_s, ex.times_s, side="right")] == STANDBY
    if noise is None or not coasts.any():
        return np.zeros(len(record))
    flat = Flat.of(model)
    stands = free_states(record, flat, start)[:, OMEGA] == 0.0
    torque = draw_torque(ex.times_s, noise, rng) * coasts
    moving = np.where(stands, REST, np.where(coasts, COASTS, DRIVEN))
    return driven_output(
        ex.times_s, moving, torque, model.number("linear.gain_deg_s_per_pct"), model.number("linear.tau_s"), record.kind
    )


def _mean(draws: Sequence[Errors]) -> Errors:
    pooled = pool(draws)
    assert pooled is not None
    return replace(pooled, samples=draws[0].samples)


def refitted(fitted: Fit, noises: Sequence[np.ndarray]) -> Model:
    """The model that a fit to a replica would give, by one step: ``noises`` are the replica's residuals, one a record.

    Counts pull an estimate a little off the truth, and a fitted model is judged with that error in it. A moment stays:
    it was searched, and its derivative says nothing of how far off it is.
    """
    parameters = [fitted.model.parameter(name) for name in fitted.names]
    followed = [i for i, q in enumerate(parameters) if not (q.ragged and q.neutral is None)]
    if not followed:
        return fitted.model
    columns = [c[:, followed] for c in fitted.jacobians]
    hessian = sum(c.T @ c for c in columns)
    gradient = sum(c.T @ n for c, n in zip(columns, noises, strict=True))
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    step = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=1e-8) @ (gradient / scale) / scale
    values: dict[str, Value] = {}
    for i, change in zip(followed, step, strict=True):
        name, parameter = fitted.names[i], parameters[i]
        values[name] = float(np.clip(fitted.model.number(name) + change, parameter.lower, parameter.upper))
    return fitted.model.with_values(values)


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
    return [refitted(fitted, replica_errors(fitted, records, rng, anywhere=anywhere)) for _ in range(count)]


def replica_errors(
    fitted: Fit, records: Sequence[Record], rng: np.random.Generator, *, anywhere: bool = False
) -> list[np.ndarray]:
    """What a fitted model would leave of one draw of its own readings, for each record, as the fit weighs it."""
    flat = Flat.of(fitted.model)
    known: Sequence[np.ndarray | None] = [None] * len(records)
    if not anywhere and not fitted.windows:  # windows do not say where in its count a whole run stands
        known = fitted.errors(records)
    return [
        errors(r, flat, s, fitted.windows, replica(r, fitted.model, s, rng, e))
        for r, s, e in zip(records, fitted.starts, known, strict=True)
    ]


def replica_floor(
    record: Record, model: Model, judgement: Judgement, models: Sequence[Model], rng: np.random.Generator
) -> Floor:
    """Floor of a record: replicas of the judged model, each judged by the model that would be fitted to it."""
    start, residual = judgement.start, judgement.free_residual
    draws = [judge(record, m, replica(record, model, start, rng, residual), near=start) for m in models]
    none = np.empty(0)
    slim = tuple(replace(d, simulated=none, free_residual=none, window_residual=none) for d in draws)
    return Floor(_mean([d.errors for d in draws]), "replicas", slim)


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
) -> list[Floor]:
    """Floors of records by replicas of a model, as judged by ``models``; the scatter of repeats counts where larger."""
    draws = rng.spawn(len(records))
    found = each(lambda i: replica_floor(records[i], model, judgements[i], models, draws[i]), range(len(records)))
    for group in repeats(records):
        free, windows = scatter([judgements[i].free_residual for i in group], records[group[0]].windows)
        for i in group:
            was = found[i].errors
            if windows > 1.1 * was.window_rms or free > 1.1 * was.free_run_rms:
                larger = replace(was, free_run_rms=max(free, was.free_run_rms), window_rms=max(windows, was.window_rms))
                found[i] = Floor(larger, "repeats", found[i].draws)
    return found
