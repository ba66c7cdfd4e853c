"""The likelihood of a sensor's noise and a random torque, by what a model leaves in pieces of steady motion.

The residual of a piece is N(0, sigma_m^2 I + counts + sigma_p^2 H C(tau_d) H'), H the motor from torque to output.
What the piece's own angle and speed at its beginning can take is projected off: restricted maximum likelihood
(Patterson and Thompson 1971). Where each reading errs by its own, one basis makes that diagonal for all sizes; where
what one speed lacks the next one has, the filter of the noise takes a time that grows with the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from fiohost.noise import covariance
from fiohost.noise.innovations import LINKS, STATES, follow
from fiohost.noise.innovations import deviances as by_filter
from fiohost.noise.settings import SETTINGS, NoiseSettings

# No reading is better known than to this share of what is left, in squares: a sensor may have neither counts nor noise.
LEAST_VARIANCE = 1e-12


@dataclass(frozen=True)
class Motor:
    """The fitted motor as a torque meets it, and the sensor: ``gain`` in the output's unit per percent (of an angle:
    per second), lag, kind of output, ``quantum``, 0 where there are no counts, and the time between samples. Of a
    speed the sensor's noise may be ``of_angle``: what one reading lacks, the next one has.
    """

    gain: float
    tau_s: float
    kind: int
    quantum: float
    step_s: float
    of_angle: bool = False

    @property
    def by_differences(self) -> bool:
        """Whether what readings err by is that of two angles."""
        return self.of_angle or self.kind == covariance.MEAN_SPEED

    def sensed(self, sensor: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
        """Variances by which a reading errs, for each rms of a ``sensor`` (n): its own noise (n), its own count, and
        what the next reading lacks of it (n).
        """
        noise, count = sensor**2, self.quantum**2 / 12.0
        own, shared = (0.0, count) if self.kind == covariance.MEAN_SPEED else (count, 0.0)
        if self.of_angle:  # as counts of a mean speed, half of it from either end
            return 0.0 * noise, own, shared + 0.5 * noise
        return noise, own, shared + 0.0 * noise

    @property
    def count_rms(self) -> float:
        """How much one reading errs by its counts: an angle's by one count's error, a mean speed's by two."""
        errors = {covariance.ANGLE: 1.0, covariance.MEAN_SPEED: 2.0}.get(self.kind, 0.0)
        return self.quantum * float(np.sqrt(errors / 12.0))


@dataclass(frozen=True)
class Group:
    """Pieces of one length and motor: what a model leaves of each (n, pieces), in the output's unit; of which ``run``
    they are, and how many times ``louder`` the sensor is there than in all.
    """

    residuals: np.ndarray = field(repr=False)
    motor: Motor
    run: str = ""
    louder: float = 1.0


def pieces(
    residual: np.ndarray,
    speed: np.ndarray,
    lag_s: np.ndarray,
    edges: np.ndarray,
    motor: Motor,
    run: str = "",
    settings: NoiseSettings = SETTINGS,
) -> list[Group]:
    """Pieces of steady motion of a ``run``, of one of the settled lengths each, those of one length and lag together.

    ``residual`` (n) is what windows with free angle and speed leave, ``speed`` (n) the model's in the output's unit per
    second and ``lag_s`` (n) that with which it settles, ``edges`` (m + 1) those of the windows. Where the model stands,
    turns or creeps there is no piece: counts do not err at random there, and the shaft may have turned while the model
    did not.
    """
    lengths = sorted({max(round(s / motor.step_s), settings.shortest_samples) for s in settings.lengths_s})
    slowest = settings.slowest_share * float(np.max(np.abs(speed), initial=0.0))
    if motor.kind == covariance.ANGLE:
        slowest = max(slowest, settings.slowest_counts * motor.quantum / motor.step_s)
    way = np.sign(speed) * (np.abs(speed) > slowest)
    found: dict[int, list[tuple[np.ndarray, float]]] = {}
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        turns = [a, *(a + 1 + np.flatnonzero(np.diff(way[a:b]))).tolist(), b]
        for first, last in zip(turns[:-1], turns[1:], strict=True):
            while last - first >= lengths[0] and way[first] != 0.0:
                n = max(length for length in lengths if length <= last - first)
                longer = max(float(np.median(lag_s[first : first + n])), 1e-9) / motor.tau_s
                found.setdefault(round(np.log(longer) / settings.lags_apart), []).append(
                    (residual[first : first + n], longer)
                )
                first += n
    groups = []
    for alike in sorted(found.values(), key=lambda parts: sum(len(p) for p, _ in parts))[-settings.most_lags :]:
        longer = float(np.median([one for _, one in alike]))
        there = replace(motor, gain=motor.gain * longer, tau_s=motor.tau_s * longer)
        for n in sorted({len(p) for p, _ in alike}):
            groups.append(Group(np.column_stack([p for p, _ in alike if len(p) == n]), there, run))
    return groups


def merged(groups: Sequence[Group]) -> list[Group]:
    """Groups of one length, motor and loudness as one, whatever their run."""
    alike: dict[tuple[int, Motor, float], list[np.ndarray]] = {}
    for group in groups:
        alike.setdefault((len(group.residuals), group.motor, group.louder), []).append(group.residuals)
    return [Group(np.column_stack(parts), motor, louder=louder) for (_, motor, louder), parts in alike.items()]


def usual(groups: Sequence[Group], settings: NoiseSettings = SETTINGS) -> list[Group]:
    """The groups without the pieces that leave far more than half of those of their length do (trimmed likelihood, Hadi
    and Luceño 1997): there a shaft stuck, or went, where the model's did not, and no random torque says what it did. A
    run that leaves more as a whole, as one whose sensor is louder, is allowed as much more.
    """
    alike: dict[tuple[int, Motor], list[np.ndarray]] = {}
    left = [np.mean(g.residuals**2, axis=0) for g in groups]
    for group, own in zip(groups, left, strict=True):
        alike.setdefault((len(group.residuals), group.motor), []).append(own)
    half = {key: float(np.median(np.concatenate(own))) + key[1].count_rms ** 2 for key, own in alike.items()}
    times = [own / max(half[len(g.residuals), g.motor], 1e-300) for g, own in zip(groups, left, strict=True)]
    by_run: dict[str, list[np.ndarray]] = {}
    for group, own in zip(groups, times, strict=True):
        by_run.setdefault(group.run, []).append(own)
    most = {run: settings.most_of_usual**2 * max(1.0, float(np.median(np.concatenate(r)))) for run, r in by_run.items()}
    kept = [replace(g, residuals=g.residuals[:, own <= most[g.run]]) for g, own in zip(groups, times, strict=True)]
    return [g for g in kept if g.residuals.size]


@lru_cache(maxsize=1024)
def _torque_part(n: int, tau_s: float, kind: int, step_s: float, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Of pieces of n samples: the basis (n, m) outside their starts in which the torque's covariance is diagonal, and
    that diagonal (m) for 1 % and a motor of unit gain.
    """
    times, moving = np.arange(n) * step_s, covariance.Movement.steady(n, tau_s)
    free = covariance.outside(covariance.starts(times, moving, kind))
    acts = free.T @ covariance.response(times, moving, 1.0, tau_s, kind)
    values, vectors = np.linalg.eigh(acts @ covariance.torque(times, time_s) @ acts.T)
    return free @ vectors, np.maximum(values, 0.0)


def _by_covariance(
    group: Group, time_s: float, sensors: np.ndarray, torques: np.ndarray, least: float, settings: NoiseSettings
) -> np.ndarray:
    """-2 log likelihood (sensors, torques) of a group whose readings err each by its own: it is diagonal."""
    (n, count), motor = group.residuals.shape, group.motor
    tau_s = float(np.exp(settings.lag_step * np.round(np.log(motor.tau_s) / settings.lag_step)))
    basis, torque = _torque_part(n, tau_s, motor.kind, motor.step_s, time_s)
    left, power = basis.T @ group.residuals, (torques * motor.gain) ** 2
    noise, own, _ = motor.sensed(group.louder * sensors)
    variance = (noise + own + least)[:, None, None] + power[None, :, None] * torque
    return np.asarray(np.sum(count * np.log(variance) + np.sum(left**2, axis=1) / variance, axis=2))


def together(groups: Sequence[Group]) -> list[Pieces]:
    """Groups as the filter takes them, those of one motor and loudness as one."""
    alike: dict[tuple[Motor, float], list[np.ndarray]] = {}
    for group in groups:
        alike.setdefault((group.motor, group.louder), []).append(group.residuals)
    return [Pieces.of(parts, motor, louder) for (motor, louder), parts in alike.items()]


@dataclass(frozen=True)
class Pieces:
    """Pieces of one motor, however long: columns (n, c), the longest first, of which ``lasting`` (n) go on so far."""

    columns: np.ndarray
    lasting: np.ndarray
    motor: Motor
    louder: float

    @classmethod
    def of(cls, residuals: Sequence[np.ndarray], motor: Motor, louder: float) -> Pieces:
        """Of residuals (n, pieces) of several lengths."""
        parts = sorted(residuals, key=len, reverse=True)
        columns = np.zeros((len(parts[0]), sum(p.shape[1] for p in parts)))
        lasting, at = np.zeros(len(columns), dtype=np.int64), 0
        for part in parts:
            at += part.shape[1]
            columns[: len(part), at - part.shape[1] : at] = part
            lasting[: len(part)] = at
        return cls(columns, lasting, motor, louder)

    def deviances(self, time_s: float, sensors: np.ndarray, torques: np.ndarray, least: float) -> np.ndarray:
        """-2 log likelihood (sensors, torques) but for a constant; no variance of a reading is below ``least``."""
        n, motor = len(self.columns), self.motor
        rows, links, ones, lags = np.arange(n), np.zeros((n, LINKS)), np.ones(n), np.full(n, motor.tau_s)
        follow(rows * motor.step_s, lags, ones, rows, rows == 0, motor.gain, motor.tau_s, motor.kind, time_s, links)
        links[-1] = links[0]
        noise, count, shared = motor.sensed(self.louder * sensors)
        found = np.zeros((len(sensors), len(torques)))
        by_filter(
            self.columns, self.lasting, links, noise + count + least, shared, torques**2, motor.kind,
            np.zeros((n, STATES)), np.zeros(n), np.zeros((STATES, STATES)), np.zeros((STATES, self.columns.shape[1])),
            found,
        )  # fmt: skip
        return found


def deviances(
    groups: Sequence[Group], axes: Sequence[np.ndarray], least: float, settings: NoiseSettings = SETTINGS
) -> np.ndarray:
    """-2 log likelihood (times, sensors, torques), but for a constant, at ``axes``: times (n), the sensor's noise (k)
    and torques (n, m), a row for each time; no variance of a reading is below ``least``.
    """
    times_s, sensors, torques = axes
    apart = [g for g in groups if not g.motor.by_differences]
    differing = together([g for g in groups if g.motor.by_differences])
    return np.array(
        [
            sum(_by_covariance(g, t, sensors, row, least, settings) for g in apart)
            + sum(p.deviances(t, sensors, row, least) for p in differing)
            for t, row in zip(times_s.tolist(), torques, strict=True)
        ]
    )
