"""Sensor noise and random torque, estimated from what a model leaves in pieces of steady motion.

The residual of a piece is N(0, sigma_m^2 I + counts + sigma_p^2 H C(tau_d) H'), H the motor from torque to output.
What the piece's own angle and speed at its beginning can take is projected off: restricted maximum likelihood
(Patterson and Thompson 1971). The deviance is looked at on a grid, ever closer around its minimum; intervals are where
its profile stays near that (Wilks 1938).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from fiohost.noise import covariance
from fiohost.noise.runs import NO_SCATTER, RunToRun
from fiohost.noise.settings import SETTINGS, NoiseSettings


@dataclass(frozen=True)
class Ranged:
    """A number with its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Noise:
    """What is left of a true model: ``sensor`` rms in the output's unit beside its counts, ``torque_pct`` of duty rms
    with the correlation time ``torque_s``, and what differs between ``runs``. ``deviance`` is -2 log likelihood;
    ``samples`` are those that it is from. ``likely`` (k, 3) are draws of the three together, as data leave them open.
    """

    sensor: Ranged
    torque_pct: Ranged
    torque_s: Ranged
    deviance: float = 0.0
    samples: int = 0
    runs: RunToRun = NO_SCATTER
    likely: np.ndarray | None = field(default=None, repr=False, compare=False)

    def drawn(self, u: float) -> Noise:
        """The noise as it may be, for one bootstrap sample; ``u`` from 0 to 1 says which of those that are likely."""
        if self.likely is None:
            return self
        sensor, torque_pct, torque_s = (Ranged(v, v, v) for v in self.likely[int(u * len(self.likely))].tolist())
        return replace(self, sensor=sensor, torque_pct=torque_pct, torque_s=torque_s)

    def near(self, other: Noise, share: float) -> bool:
        """Whether another noise differs by no more than a share of what these intervals leave open."""
        pairs = ((self.sensor, other.sensor), (self.torque_pct, other.torque_pct), (self.torque_s, other.torque_s))
        return all(abs(a.value - b.value) <= share * (a.high - a.low) for a, b in pairs)

    @property
    def walk_pct(self) -> float:
        """How far the torque wanders in the first second, in percent of duty, did it go on as it begins."""
        return self.torque_pct.value * (2.0 / self.torque_s.value) ** 0.5 if self.torque_s.value > 0.0 else 0.0

    def wanders_pct(self, seconds: float, settings: NoiseSettings = SETTINGS) -> float:
        """How far the torque wanders in some time, rms in percent of duty. Where its correlation time is longer than
        the longest pieces that it is from, nothing says that it comes back: it walks on.
        """
        held = self.torque_s.low <= settings.lengths_s[-1]
        return self.torque_pct.value if held else max(self.torque_pct.value, self.walk_pct * seconds**0.5)

    @property
    def torque_known(self) -> bool:
        """Whether there is a torque at all, within what the data can tell."""
        return self.torque_pct.low > 0.0

    @property
    def only_counts(self) -> bool:
        """Whether the sensor's counts may be all there is, within what the data can tell."""
        return not (self.torque_known or self.sensor.low > 0.0 or self.runs.known)


# Directions in which a torque adds less than this share to the variance do not count.
LEAST_DIRECTION = 1e-3
# No reading is better known than to this share of what is left, in squares: a sensor may have neither counts nor noise.
LEAST_VARIANCE = 1e-12

# Parts of pieces of so many samples at most are kept: each takes 10 n^2 numbers.
LONGEST_KEPT = 60

# By so much a profile's deviance rises at the ends of a 95 % interval where pieces are independent.
CHI_SQUARED_95 = 3.841

NONE = Noise(Ranged(0.0, 0.0, 0.0), Ranged(0.0, 0.0, 0.0), Ranged(0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Motor:
    """The fitted motor as a torque meets it, and the sensor: ``gain`` in the output's unit per percent (of an angle:
    per second), lag, kind of output, ``quantum``, 0 where there are no counts, and the time between samples.
    """

    gain: float
    tau_s: float
    kind: int
    quantum: float
    step_s: float


@dataclass(frozen=True)
class Group:
    """Pieces of one length and motor: what a model leaves of each (n, pieces), in the output's unit."""

    residuals: np.ndarray = field(repr=False)
    motor: Motor


def pieces(
    residual: np.ndarray,
    speed: np.ndarray,
    lag_s: np.ndarray,
    edges: np.ndarray,
    motor: Motor,
    settings: NoiseSettings = SETTINGS,
) -> list[Group]:
    """Pieces of steady motion, of one of the settled lengths each, those of one length and lag together.

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
            groups.append(Group(np.column_stack([p for p, _ in alike if len(p) == n]), there))
    return groups


def _merged(groups: Sequence[Group]) -> list[Group]:
    """Groups of one length and motor as one."""
    alike: dict[tuple[int, Motor], list[np.ndarray]] = {}
    for group in groups:
        alike.setdefault((len(group.residuals), group.motor), []).append(group.residuals)
    return [Group(np.column_stack(parts), motor) for (_, motor), parts in alike.items()]


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
def _counted_part(n: int, tau_s: float, step_s: float, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Of pieces of n mean speeds: variances (m) that counts of a unit quantum have along directions (m, m) in which
    they are apart from each other, in the basis of ``_torque_part``.
    """
    basis, _ = _torque_part(n, tau_s, covariance.MEAN_SPEED, step_s, time_s)
    values, vectors = np.linalg.eigh(basis.T @ covariance.counts(n, 1.0, covariance.MEAN_SPEED) @ basis)
    return np.maximum(values, 0.0), vectors


def _rounded(tau_s: float, settings: NoiseSettings) -> float:
    """A lag near enough for the shape of covariances, so that work on them serves for all models of one motor."""
    return float(np.exp(settings.lag_step * np.round(np.log(tau_s) / settings.lag_step)))


@lru_cache(maxsize=1024)
def _sensed_part(
    n: int,
    tau_s: float,
    step_s: float,
    time_s: float,
    quantum: float,
    sensors: tuple[float, ...],
    least: float,
    most: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of pieces of n mean speeds, for each of some sensors' noise: variances (sensors, m) without a torque; how many
    times these a torque of 1 % and a motor of unit gain has (sensors, k), and what a piece has along its directions
    (sensors, k, m), both in those of ``_counted_part``.

    Counts of a mean speed are not white: where they are apart from each other, a torque is a correction of few
    directions (Woodbury 1950), those in which the ``most`` of it, as a variance, shows beside them.
    """
    _, torque = _torque_part(n, tau_s, covariance.MEAN_SPEED, step_s, time_s)
    spread, apart = _counted_part(n, tau_s, step_s, time_s)
    own = spread * quantum**2 + np.array(sensors)[:, None] ** 2
    own += 1e-12 * own.max(axis=1, keepdims=True) + least
    shows = most * torque * ((apart**2) @ (1.0 / own.min(axis=0)))
    seen = np.flatnonzero(shows > LEAST_DIRECTION)
    acts = apart[seen].T * np.sqrt(torque[seen])
    weighed = acts.T[None] / own[:, None, :]  # (sensors, k, m)
    sizes, along = np.linalg.eigh(weighed @ acts)
    return own, np.maximum(sizes, 0.0), np.swapaxes(along, 1, 2) @ weighed


def _group_deviances(
    group: Group, time_s: float, sensors: np.ndarray, torques: np.ndarray, least: float, settings: NoiseSettings
) -> np.ndarray:
    """-2 log likelihood (sensors, torques) of the pieces of a group, but for a constant; no variance is below
    ``least``.
    """
    (n, count), motor = group.residuals.shape, group.motor
    tau_s = _rounded(motor.tau_s, settings)
    basis, torque = _torque_part(n, tau_s, motor.kind, motor.step_s, time_s)
    left, power = basis.T @ group.residuals, (torques * motor.gain) ** 2
    if motor.kind != covariance.MEAN_SPEED:
        own = sensors**2 + motor.quantum**2 / 12.0 + least
        variance = own[:, None, None] + power[None, :, None] * torque
        return np.asarray(np.sum(count * np.log(variance) + np.sum(left**2, axis=1) / variance, axis=2))
    _, apart = _counted_part(n, tau_s, motor.step_s, time_s)
    # What serves again is kept but of long pieces, of which it would fill the memory.
    part = _sensed_part if n <= LONGEST_KEPT else _sensed_part.__wrapped__
    # A torque that would leave far more than there is need not be judged well.
    enough = settings.most_left**2 * float(np.mean(left**2)) * len(torque) / max(float(torque.sum()), 1e-300)
    most = 2.0 ** np.ceil(np.log2(max(min(float(power.max()), enough), 1e-300)))
    own, sizes, along = part(n, tau_s, motor.step_s, time_s, motor.quantum, tuple(sensors.tolist()), least, most)
    left = apart.T @ left
    pulls = np.sum((along @ left) ** 2, axis=2)
    fixed = count * np.log(own).sum(axis=1) + (np.sum(left**2, axis=1) / own).sum(axis=1)
    grown = 1.0 + power[None, :, None] * sizes[:, None, :]
    pulled = power[None, :, None] / grown * pulls[:, None, :]
    return np.asarray(fixed[:, None] + np.sum(count * np.log(grown) - pulled, axis=2))


def _deviances(
    groups: Sequence[Group],
    settings: NoiseSettings,
    axes: Sequence[np.ndarray],
    least: float,
) -> np.ndarray:
    """-2 log likelihood (times, sensors, torques) at all of the ``axes`` together, but for a constant."""
    times_s, sensors, torques = axes

    def of(group: Group, time_s: float) -> np.ndarray:
        return _group_deviances(group, time_s, sensors, torques, least, settings)

    return np.array([sum(of(g, t) for g in groups) for t in times_s.tolist()])


def estimate(
    groups: Sequence[Group],
    *,
    sensor: float | None = None,
    settings: NoiseSettings = SETTINGS,
) -> Noise:
    """The noise of grouped pieces; ``sensor`` where its noise is declared, in the output's unit. None of no pieces."""
    groups = _merged(groups)
    samples = sum(g.residuals.size for g in groups)
    if samples == 0:
        return NONE if sensor is None else Noise(Ranged(sensor, sensor, sensor), NONE.torque_pct, NONE.torque_s)
    rms = float(np.sqrt(sum(float(np.sum(g.residuals**2)) for g in groups) / samples)) + 1e-150
    # Looks that begin alike serve alike for all models of one motor.
    rms = float(np.exp(settings.noise_step * np.ceil(np.log(rms) / settings.noise_step)))
    least = LEAST_VARIANCE * rms**2
    times = np.geomspace(*settings.times_s, settings.time_looks)
    sensors = np.concatenate(([0.0], rms * np.geomspace(*settings.sensor_span, settings.sensor_looks)))
    sensors = sensors if sensor is None else np.array([sensor])
    torques = np.concatenate(([0.0], np.geomspace(*settings.torque_span_pct, settings.torque_looks)))
    axes = [times, sensors, torques]
    # The sensor's noise is known best by far: found first, so that no torque makes up for a coarse look at it.
    for closer in [(1,)] * settings.sensor_zooms + [(0, 1, 2)] * settings.zooms:
        deviances = _deviances(groups, settings, axes, least)
        for i in closer:
            axes[i] = _closer(axes[i], _profile(deviances, i), settings)
    deviances = _deviances(groups, settings, axes, least)
    best = np.unravel_index(int(np.argmin(deviances)), deviances.shape)
    ranged = [_ranged(x, _profile(deviances, i), settings) for i, x in enumerate(axes)]
    time = ranged[0] if best[2] > 0 or axes[2][0] > 0.0 else Ranged(0.0, *settings.times_s)
    return Noise(ranged[1], ranged[2], time, float(deviances.min()), samples, likely=_likely(deviances, axes, settings))


def _likely(deviances: np.ndarray, axes: Sequence[np.ndarray], settings: NoiseSettings) -> np.ndarray:
    """Draws (k, 3) of sensor, torque and its time, as likely as the data say, from looks (times, sensors, torques)
    around their best: at even steps of the likelihood summed up (systematic sampling).
    """
    counts = CHI_SQUARED_95 / settings.interval_deviance
    chance = np.cumsum(np.exp(-0.5 * counts * (deviances - deviances.min())).ravel())
    steps = (np.arange(settings.likely) + 0.5) / settings.likely * chance[-1]
    times, sensors, torques = np.unravel_index(np.searchsorted(chance, steps), deviances.shape)
    return np.column_stack([axes[1][sensors], axes[2][torques], axes[0][times]])


def _profile(deviances: np.ndarray, axis: int) -> np.ndarray:
    return np.asarray(deviances.min(axis=tuple(i for i in range(deviances.ndim) if i != axis)))


def _closer(x: np.ndarray, profile: np.ndarray, settings: NoiseSettings) -> np.ndarray:
    """The grid (n) drawn anew around what is near the least deviance, a step more on either side."""
    if len(x) == 1:
        return x
    near = np.flatnonzero(profile <= profile.min() + settings.near_deviance)
    low, high = x[max(near[0] - 1, 0)], x[min(near[-1] + 1, len(x) - 1)]
    if low > 0.0:
        return np.asarray(np.geomspace(low, high, len(x)))
    return np.asarray(np.linspace(0.0, high, len(x)))


def _ranged(x: np.ndarray, profile: np.ndarray, settings: NoiseSettings) -> Ranged:
    """Value and interval from a profile (n): where it crosses its level, between the looks by straight lines."""
    best, level = int(np.argmin(profile)), float(profile.min()) + settings.interval_deviance
    if len(x) == 1:
        return Ranged(float(x[0]), float(x[0]), float(x[0]))
    value = float(x[best])
    if 0 < best < len(x) - 1:  # the minimum of the parabola through three looks
        a, b, c = (float(v) for v in profile[best - 1 : best + 2])
        left, right = value - float(x[best - 1]), float(x[best + 1]) - value
        bend = (a - b) / left + (c - b) / right
        slope = ((c - b) / right * left - (a - b) / left * right) / (left + right)
        value -= float(np.clip(slope / bend * 0.5 * (left + right), -left, right)) if bend > 0.0 else 0.0
    inside = profile <= level
    first, last = int(np.argmax(inside)), len(x) - 1 - int(np.argmax(inside[::-1]))
    low = float(x[first]) if first == 0 else _crossing(x, profile, first - 1, level)
    high = float(x[last]) if last == len(x) - 1 else _crossing(x, profile, last, level)
    return Ranged(value, min(low, value), max(high, value))


def _crossing(x: np.ndarray, profile: np.ndarray, i: int, level: float) -> float:
    share = (level - profile[i]) / (profile[i + 1] - profile[i])
    return float(x[i] + share * (x[i + 1] - x[i]))
