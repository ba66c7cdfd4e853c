"""What is normal, from a stretch of normal running: the motor as it stands, its noise, and how statistics spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, ndtri

from fiohost.discover.logs.whitened import motor_of, noise_of
from fiohost.errors import DataError
from fiohost.estimation.fit import fit_from_scratch
from fiohost.estimation.predict import Flat
from fiohost.estimation.record import ANGLE, Record
from fiohost.motor.model import Model
from fiohost.noise.estimate import Noise
from fiohost.noise.runs import varied
from fiohost.watch.candidates import Candidate, candidates
from fiohost.watch.detector import Detector, Normal
from fiohost.watch.evidence import DRIFTS, Whitening, Window, begin_of, evidence
from fiohost.watch.replicas import normal_run
from fiohost.watch.settings import SETTINGS, WatchSettings


@dataclass(frozen=True)
class Learned:
    """The model that is watched, what may change in it, its noise and what is normal of its windows."""

    model: Model
    candidates: tuple[Candidate, ...]
    noise: Noise
    whitening: Whitening
    normal: Normal

    def evidence(self, record: Record, offset_s: float = 0.0, around: np.ndarray | None = None) -> list[Window]:
        """The windows of a record against this model, seen from where it has drifted to."""
        at = np.zeros(DRIFTS) if around is None else around
        changes = candidates(varied(self.model, at), angle=record.kind == ANGLE) if at.any() else self.candidates
        return evidence(record, self.model, at, changes, self.whitening, offset_s)

    def detector(self, settings: WatchSettings = SETTINGS) -> Detector:
        return Detector(self.candidates, self.normal, settings)


def learn(
    record: Record, model: Model, settings: WatchSettings = SETTINGS, seed: int = 0, *, fitted: bool = False
) -> Learned:
    """Learn from a record of normal running. A model without values of its own is fitted to it; one with values (or
    ``fitted``) is kept, but for gain, friction and load as they are today. Raises DataError of too short a record.
    """
    if record.seconds < settings.least_learn_s:
        raise DataError(
            f"{record.name}: {record.seconds:.1f} s of normal running are too few to learn from, "
            f"at least {settings.least_learn_s:g} s are needed"
        )
    model = model.on_axis(record.rotary).with_pwm(record.pwm_hz)
    if not (fitted or model.given):
        model = fit_from_scratch(model, [record]).model
    model, noise = _as_it_stands(record, model, settings)
    changes = tuple(candidates(model, angle=record.kind == ANGLE))
    whitening = Whitening(motor_of(record, model), noise)
    unit_spread = np.ones((len(changes) + 1, len(settings.lengths)))
    windows = evidence(record, model, np.zeros(DRIFTS), changes, whitening)
    lacks, unsure = _lacks(windows, changes)
    plain = Normal(np.zeros(DRIFTS), np.eye(DRIFTS), 1.0, unit_spread, lacks, np.zeros_like(unsure))
    power = max(_power([plain.corrected(w) for w in windows]), 1.0)
    start = replace(plain, covariance=_posterior(windows, power, settings), power=power)
    spread = _spread(record, model, noise, changes, whitening, start, settings, seed) * settings.tail_widening
    return Learned(model, changes, noise, whitening, replace(start, spread=spread, unsure=unsure * power))


def _lacks(windows: Sequence[Window], changes: Sequence[Candidate]) -> tuple[np.ndarray, np.ndarray]:
    """What the model lacks in normal running (k): all columns at once, each held to its usual size, the drift free, so
    that nothing is lacked of what drifts; and the covariance of all but the drift (k - 3, k - 3), for windows of unit
    power.
    """
    usual = np.array([1e6] * DRIFTS + [c.usual for c in changes for _ in c.columns])
    seen = sum(w.information for w in windows)
    # Gain, friction and load stand there again, as what may jump; a model without friction has none that drifts.
    usual[DRIFTS : 2 * DRIFTS] *= np.where(np.diag(seen)[:DRIFTS] > 0.0, 1e-6, 1.0)
    information = seen + np.diag(1.0 / usual**2)
    found = np.linalg.solve(information, sum(w.score for w in windows))
    found[:DRIFTS] = 0.0
    return np.asarray(found), np.linalg.inv(information)[DRIFTS:, DRIFTS:]


def _as_it_stands(record: Record, model: Model, settings: WatchSettings) -> tuple[Model, Noise]:
    """The model with today's gain, friction and load, and the noise that it leaves."""
    for _ in range(settings.rounds):
        start = begin_of(record, Flat.of(model))
        noise = noise_of(model, [start], [record])
        windows = evidence(record, model, np.zeros(DRIFTS), (), Whitening(motor_of(record, model), noise))
        if not windows:
            raise DataError(f"{record.name}: no window of one second is whole, so that nothing can be watched")
        power = max(_power(windows), 1.0)
        information = sum(w.information for w in windows) / power + _prior(settings)
        shift = np.linalg.solve(information, sum(w.score for w in windows) / power)
        within = np.array(settings.begins_within)
        model = varied(model, np.clip(shift, -2.0 * within, 2.0 * within))
        if np.all(np.abs(shift) <= settings.moves * within):
            break
    return model, noise


def _prior(settings: WatchSettings) -> np.ndarray:
    return np.diag(1.0 / np.square(settings.begins_within))


def _posterior(windows: Sequence[Window], power: float, settings: WatchSettings) -> np.ndarray:
    """Covariance (3, 3) of what drifts, once it has been found on these windows; it drifts meanwhile."""
    own = np.linalg.inv(sum(w.information[:DRIFTS, :DRIFTS] for w in windows) / power + _prior(settings))
    seconds = windows[-1].end_s - windows[0].begin_s
    return np.asarray(own + np.diag(np.square(settings.drift_per_minute)) / 60.0 * seconds / 3.0)


def _power(windows: Sequence[Window]) -> float:
    """A window's power by its degrees of freedom, the median: a start of the shaft may leave more in some."""
    return float(np.median([w.power / w.freedom for w in windows])) if windows else 1.0


def _spread(
    record: Record, model: Model, noise: Noise, changes: tuple[Candidate, ...], whitening: Whitening, start: Normal,
    settings: WatchSettings, seed: int,
) -> np.ndarray:  # fmt: skip
    """How much wider than their distribution the statistics are in replicas of normal running and in the record."""
    rng = np.random.default_rng(seed)
    begin, runs = begin_of(record, Flat.of(model)), [record]
    per_run = max(len(record.windows) - 1, 1)
    for _ in range(max(1, int(np.ceil(settings.replica_windows / per_run)))):
        y = normal_run(record, model, begin, noise, settings.drift_per_minute, rng)
        runs.append(replace(record, y=y))
    squares: list[list[np.ndarray]] = [[] for _ in settings.lengths]
    powers: list[list[float]] = [[] for _ in settings.lengths]
    quantile, freedoms = settings.spread_quantile, np.array([len(c.columns) for c in changes])
    for run in runs:
        own = start if run is record else replace(start, lacks=np.zeros_like(start.lacks))
        detector = Detector(changes, own, settings)
        for window in evidence(run, model, np.zeros(DRIFTS), changes, whitening):
            detector.follow(window)
            if detector.windows < min(settings.lengths):
                continue
            looks = detector.looks()
            for j, (square, power_of) in enumerate(zip(looks.squares, looks.power, strict=True)):
                squares[j].append(square)
                powers[j].append(float(power_of))
    spread = np.ones((len(changes) + 1, len(settings.lengths)))
    for j in range(len(settings.lengths)):
        if not squares[j]:
            spread[:, j] = spread[:, max(j - 1, 0)]
            continue
        wide = np.quantile(np.array(squares[j]), quantile, axis=0) / chdtri(freedoms, 1.0 - quantile)
        spread[:-1, j] = np.maximum(wide, 1.0)
        spread[-1, j] = max(float(np.quantile(powers[j], quantile)) / ndtri(quantile), 1.0)
        if j:  # of longer looks there are fewer that are independent
            spread[:, j] = np.maximum(spread[:, j], 0.8 * spread[:, j - 1])
    return spread
