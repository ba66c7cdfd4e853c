"""The figures by which a model is judged on a record, as defined in the diagnosis schema."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.estimation.initial import initial_state
from fiohost.estimation.predict import Begun, Flat, free_output, free_states, read, window_residuals
from fiohost.estimation.record import ANGLE, MEAN_SPEED, Record
from fiohost.judging.settings import FLOOR
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start


@dataclass(frozen=True)
class Errors:
    """``E`` of the diagnosis: rms in the output's unit, shares in percent."""

    free_run_rms: float
    window_rms: float
    bin_violation_pct: float | None
    fit_pct: float | None
    samples: int

    def to_json(self) -> dict[str, float | int | None]:
        return {
            "free_run_rms": self.free_run_rms,
            "window_rms": self.window_rms,
            "bin_violation_pct": self.bin_violation_pct,
            "fit_pct": self.fit_pct,
            "samples": self.samples,
        }


@dataclass(frozen=True)
class Weighed:
    """A free run as a fit weighs it, the angle within its first count free: what verdicts and searches go by.

    ``square`` is the squared error summed up, ``weight`` that of ones, ``outside_pct`` the share beyond half a count.
    """

    square: float
    weight: float
    outside_pct: float | None

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.square / self.weight))


def weigh(record: Record, free: np.ndarray) -> Weighed:
    """Weigh the residual (n) of a free run.

    Where the shaft rests through the first second, that second says little of the angle within its count, and the rest
    of the run would be judged by what nobody knows.
    """
    weights, half = record.weights**2, 0.5 * record.quantum
    weight = float(weights.sum())
    offset = float(np.clip(weights @ free / weight, -half, half)) if record.kind == ANGLE else 0.0
    error = free - offset
    outside = 100.0 * float(weights @ (np.abs(error) > half)) / weight if record.quantum > 0.0 else None
    return Weighed(float(weights @ error**2), weight, outside)


@dataclass(frozen=True)
class Judgement:
    """A model on one record: the figures and what they were computed from, each array (n)."""

    errors: Errors
    start: Start
    simulated: np.ndarray
    free_residual: np.ndarray
    window_residual: np.ndarray
    weighed: Weighed
    wide_windows_pct: float | None
    windows: int


def _figures(y: np.ndarray, free: np.ndarray, windows: np.ndarray, quantum: float) -> Errors:
    spread = float(np.linalg.norm(y - y.mean()))
    return Errors(
        free_run_rms=float(np.sqrt(np.mean(free**2))),
        window_rms=float(np.sqrt(np.mean(windows**2))),
        bin_violation_pct=float(100.0 * np.mean(np.abs(free) > 0.5 * quantum)) if quantum > 0 else None,
        fit_pct=100.0 * (1.0 - float(np.linalg.norm(free)) / spread) if spread > 0 else None,
        samples=len(y),
    )


def _wide_windows(record: Record, residual: np.ndarray) -> float | None:
    """Share of one-second windows whose residual (n) spans more than one count: no angle fits all their samples.

    The true model has almost none, whatever the initial state of the run; None where the counts are not known.
    """
    if record.kind != ANGLE or record.quantum <= 0:
        return None
    return 100.0 * float(np.mean(spans(residual, record.windows[:-1]) > FLOOR.wide * record.quantum))


def spans(series: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """How far a series (n) goes within each window that begins at ``edges`` (m)."""
    return np.asarray(np.maximum.reduceat(series, edges) - np.minimum.reduceat(series, edges))


def judge(
    record: Record,
    model: Model,
    y: np.ndarray | None = None,
    *,
    near: Start | None = None,
    fitted: Start | None = None,
    begun: Begun | None = None,
) -> Judgement:
    """Judge a model on a record, or on other measurements ``y`` (n) of the same commands, begun ``near`` a start and
    its windows near where others were ``begun``.

    Where a load drifts in its gap the first second may not show: then as it was ``fitted`` to the whole run.
    """
    data = record.y if y is None else y
    flat = Flat.of(model)
    start = initial_state(record, flat, data, near=near)
    if fitted is not None and flat.gap:
        own, other = (float(np.sum((data - free_output(record, flat, s)) ** 2)) for s in (start, fitted))
        start = fitted if other < FLOOR.another_start * own else start
    flat = flat.from_zero(start.zero)
    states = free_states(record, flat, start)
    simulated = read(record, flat, states)
    free = data - simulated
    windows = window_residuals(record, flat, states, data, begun)
    return Judgement(
        errors=_figures(data, free, windows, record.quantum),
        start=start,
        simulated=simulated,
        free_residual=free,
        window_residual=windows,
        weighed=weigh(record, free),
        wide_windows_pct=_wide_windows(record, windows),
        windows=len(record.windows) - 1,
    )


def pool(parts: Sequence[Errors]) -> Errors | None:
    """The figures of several records together: squares and shares weighted by samples; None of none."""
    if not parts:
        return None
    weights = np.array([e.samples for e in parts], dtype=float)
    total = float(weights.sum())

    def rms(values: list[float]) -> float:
        return float(np.sqrt(np.sum(weights * np.square(values)) / total))

    def share(values: list[float | None]) -> float | None:
        known = [(w, v) for w, v in zip(weights, values, strict=True) if v is not None]
        return float(sum(w * v for w, v in known) / sum(w for w, _ in known)) if known else None

    return Errors(
        free_run_rms=rms([e.free_run_rms for e in parts]),
        window_rms=rms([e.window_rms for e in parts]),
        bin_violation_pct=share([e.bin_violation_pct for e in parts]),
        fit_pct=share([e.fit_pct for e in parts]),
        samples=int(total),
    )


def quantise(record: Record, y: np.ndarray) -> np.ndarray:
    """The sensor's reading (n) of a true output: floor for counts of an angle, rounding for a speed.

    A mean speed is a difference of two counts, so that what one reading lacks the next one has: its error has a
    standard deviation of up to half a count, not of 0.29 counts, and does not grow when it is summed up.
    """
    if record.quantum <= 0:
        return y
    if record.kind == ANGLE:
        return np.asarray(np.floor(y / record.quantum) * record.quantum)
    if record.kind == MEAN_SPEED:
        ticks = np.diff(record.excitation.times_s, prepend=-record.sample_time_s) / record.sample_time_s
        counts = np.floor(np.cumsum(y * ticks) / record.quantum)
        return np.asarray(np.diff(counts, prepend=0.0) * record.quantum / ticks)
    return np.asarray(np.round(y / record.quantum) * record.quantum)
