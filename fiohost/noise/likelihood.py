"""The likelihood of a sensor's noise and a random torque, by what a model leaves in pieces of steady motion.

The residual of a piece is N(0, sigma_m^2 I + counts + sigma_p^2 H C(tau_d) H'), H the motor from torque to output.
What the piece's own angle and speed at its beginning can take is projected off: restricted maximum likelihood
(Patterson and Thompson 1971).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from fiohost.noise import covariance
from fiohost.noise.settings import SETTINGS, NoiseSettings

# Directions in which a torque adds less than this share to the variance do not count.
LEAST_DIRECTION = 1e-3
# No reading is better known than to this share of what is left, in squares: a sensor may have neither counts nor noise.
LEAST_VARIANCE = 1e-12
# Nor readings of which each may have what the next one lacks to less than so many times that: below, what is left and
# what a torque takes of it cancel.
BY_DIFFERENCES = 1e6


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


@lru_cache(maxsize=1024)
def _counted_part(n: int, tau_s: float, kind: int, step_s: float, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Of pieces of n speeds: variances (m) that counts of a unit quantum have, as a mean speed has them, along
    directions (m, m) in which they are apart from each other, in the basis of ``_torque_part``.
    """
    basis, _ = _torque_part(n, tau_s, kind, step_s, time_s)
    values, vectors = np.linalg.eigh(basis.T @ covariance.counts(n, 1.0, covariance.MEAN_SPEED) @ basis)
    return np.maximum(values, 0.0), vectors


def _rounded(tau_s: float, settings: NoiseSettings) -> float:
    """A lag near enough for the shape of covariances, so that work on them serves for all models of one motor."""
    return float(np.exp(settings.lag_step * np.round(np.log(tau_s) / settings.lag_step)))


def _sensed_variances(n: int, motor: Motor, time_s: float, sensors: np.ndarray, least: float) -> np.ndarray:
    """Of pieces of n speeds, for each of some sensors' noise: variances (sensors, m) without a torque, in directions of
    ``_counted_part``. That of an angle is in them as counts are: they err by a sixth of their square.
    """
    spread, _ = _counted_part(n, motor.tau_s, motor.kind, motor.step_s, time_s)
    noise, count = sensors[:, None] ** 2, motor.quantum**2
    own = spread * count if motor.kind == covariance.MEAN_SPEED else np.full(len(spread), count / 12.0)
    own = own + (6.0 * noise * spread if motor.of_angle else noise)
    return np.asarray(own + 1e-12 * own.max(axis=1, keepdims=True) + least)


@lru_cache(maxsize=1024)
def _sensed_part(
    n: int,
    motor: Motor,
    time_s: float,
    sensors: tuple[float, ...],
    least: float,
    most: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of pieces of n speeds: what a torque of 1 % and a motor of unit gain does (m, k) in directions of
    ``_counted_part``; and for each of some sensors' noise how many times the variance without a torque that is
    (sensors, k), along vectors (sensors, k, k).

    Counts of a mean speed are not white: where they are apart from each other, a torque is a correction of few
    directions (Woodbury 1950), those in which the ``most`` of it, as a variance, shows beside them.
    """
    _, torque = _torque_part(n, motor.tau_s, motor.kind, motor.step_s, time_s)
    _, apart = _counted_part(n, motor.tau_s, motor.kind, motor.step_s, time_s)
    own = _sensed_variances(n, motor, time_s, np.array(sensors), least)
    shows = most * torque * ((apart**2) @ (1.0 / own.min(axis=0)))
    seen = np.flatnonzero(shows > LEAST_DIRECTION)
    acts = apart[seen].T * np.sqrt(torque[seen])
    sizes, vectors = np.linalg.eigh((acts.T[None] / own[:, None, :]) @ acts)
    return acts, np.maximum(sizes, 0.0), vectors


def group_deviances(
    group: Group, time_s: float, sensors: np.ndarray, torques: np.ndarray, least: float, settings: NoiseSettings
) -> np.ndarray:
    """-2 log likelihood (sensors, torques) of the pieces of a group, but for a constant; no variance is below
    ``least``.
    """
    (n, count), motor, sensors = group.residuals.shape, group.motor, group.louder * sensors
    tau_s = _rounded(motor.tau_s, settings)
    basis, torque = _torque_part(n, tau_s, motor.kind, motor.step_s, time_s)
    left, power = basis.T @ group.residuals, (torques * motor.gain) ** 2
    if not motor.by_differences:
        own = sensors**2 + motor.quantum**2 / 12.0 + least
        variance = own[:, None, None] + power[None, :, None] * torque
        return np.asarray(np.sum(count * np.log(variance) + np.sum(left**2, axis=1) / variance, axis=2))
    _, apart = _counted_part(n, tau_s, motor.kind, motor.step_s, time_s)
    least *= BY_DIFFERENCES if motor.of_angle or motor.quantum == 0.0 else 1.0
    # A torque that would leave far more than there is need not be judged well.
    enough = settings.most_left**2 * float(np.mean(left**2)) * len(torque) / max(float(torque.sum()), 1e-300)
    most = 2.0 ** np.ceil(np.log2(max(min(float(power.max()), enough), 1e-300)))
    shape = n, replace(motor, gain=1.0, tau_s=tau_s), time_s
    own = _sensed_variances(*shape, sensors, least)
    acts, sizes, vectors = _sensed_part(*shape, tuple(sensors.tolist()), least, most)
    left = apart.T @ left
    pulls = np.sum((np.swapaxes(vectors, 1, 2) @ (acts.T @ (left / own[:, :, None]))) ** 2, axis=2)
    fixed = count * np.log(own).sum(axis=1) + (np.sum(left**2, axis=1) / own).sum(axis=1)
    grown = 1.0 + power[None, :, None] * sizes[:, None, :]
    pulled = power[None, :, None] / grown * pulls[:, None, :]
    return np.asarray(fixed[:, None] + np.sum(count * np.log(grown) - pulled, axis=2))


def deviances(
    groups: Sequence[Group],
    settings: NoiseSettings,
    axes: Sequence[np.ndarray],
    least: float,
) -> np.ndarray:
    """-2 log likelihood (times, sensors, torques), but for a constant, at ``axes``: times (n), the sensor's noise (k)
    and torques (n, m), a row for each time.
    """
    times_s, sensors, torques = axes
    rows = zip(times_s.tolist(), torques, strict=True)
    return np.array([sum(group_deviances(g, t, sensors, row, least, settings) for g in groups) for t, row in rows])
