"""Sensor noise and random torque, estimated from what a model leaves in pieces of steady motion.

The deviance of their likelihood is looked at on a grid, ever closer around its minimum; intervals are where its profile
stays near that (Wilks 1938). A sensor may be louder in one run than in the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import chdtri

from fiohost.noise.covariance import ANGLE
from fiohost.noise.likelihood import LEAST_VARIANCE, Group, deviances, merged, usual
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
    ``louder`` says by run how many times its sensor's noise is that of all; it is empty where they are alike. A
    sensor's noise ``of_angle`` is seen in speeds: what one of them lacks, the next one has. That of mean speeds is of
    speeds ``step_s`` apart; 0 where it is the same however far apart readings are.
    """

    sensor: Ranged
    torque_pct: Ranged
    torque_s: Ranged
    deviance: float = 0.0
    samples: int = 0
    runs: RunToRun = NO_SCATTER
    louder: Mapping[str, float] = field(default_factory=dict)
    of_angle: bool = False
    step_s: float = 0.0
    likely: np.ndarray | None = field(default=None, repr=False, compare=False)

    def drawn(self, u: float) -> Noise:
        """The noise as it may be, for one bootstrap sample; ``u`` from 0 to 1 says which of those that are likely."""
        if self.likely is None:
            return self
        sensor, torque_pct, torque_s = (Ranged(v, v, v) for v in self.likely[int(u * len(self.likely))].tolist())
        return replace(self, sensor=sensor, torque_pct=torque_pct, torque_s=torque_s)

    def of(self, run: str) -> Noise:
        """The noise of one run; of another than those that were looked at as loud as any of them."""
        if not self.louder:
            return self
        if run in self.louder:
            times, sensor = self.louder[run], self.sensor
            own = Ranged(times * sensor.value, times * sensor.low, times * sensor.high)
            return replace(self, sensor=own, likely=self._as_loud([times]), louder={})
        return replace(self, likely=self._as_loud(list(self.louder.values())), louder={})

    def at(self, step_s: float) -> Noise:
        """The noise of readings so far apart: the mean of several speeds errs less than each."""
        if self.step_s in (0.0, step_s):
            return self
        longer = self.step_s / step_s
        times = longer if self.of_angle else longer**0.5
        own = Ranged(times * self.sensor.value, times * self.sensor.low, times * self.sensor.high)
        return replace(self, sensor=own, likely=self._as_loud([times]), step_s=step_s)

    def of_speeds(self, step_s: float) -> Noise:
        """The noise of an angle as mean speeds over so long have it, each the difference of two readings."""
        times = 2.0**0.5 / step_s
        own = Ranged(times * self.sensor.value, times * self.sensor.low, times * self.sensor.high)
        return replace(self, sensor=own, likely=self._as_loud([times]), of_angle=True, step_s=step_s)

    def _as_loud(self, times: Sequence[float]) -> np.ndarray | None:
        """The likely draws with the sensor so many times as loud, one after the other."""
        return None if self.likely is None else np.vstack([self.likely * (k, 1.0, 1.0) for k in times])

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


# So many looks for each that was made, once they are close.
BETWEEN = 8

# By so much a profile's deviance rises at the ends of a 95 % interval where pieces are independent.
CHI_SQUARED_95 = 3.841

NONE = Noise(Ranged(0.0, 0.0, 0.0), Ranged(0.0, 0.0, 0.0), Ranged(0.0, 0.0, 0.0))


def estimate(
    groups: Sequence[Group],
    *,
    sensor: float | None = None,
    settings: NoiseSettings = SETTINGS,
) -> Noise:
    """The noise of grouped pieces but for those that leave far more than most; ``sensor`` where its noise is declared,
    in the output's unit. None of no pieces.
    """
    groups = usual(groups, settings)
    found = _estimate(merged(groups), sensor, settings)
    if found.sensor.low > 0.0 and any(g.motor.kind != ANGLE for g in groups):
        turned = [replace(g, motor=replace(g.motor, of_angle=True)) for g in groups]
        other = replace(_estimate(merged(turned), sensor, settings), of_angle=True)
        groups, found = (turned, other) if other.deviance < found.deviance else (groups, found)
    # Beside counts that err more, what differs between runs is what these do that is no noise.
    of_counts = max((g.motor.count_rms for g in groups), default=0.0)
    louder = _louder(groups, found, settings) if sensor is None and found.sensor.low > of_counts else {}
    if not louder:
        return found
    own = merged([replace(g, louder=louder[g.run]) for g in groups])
    return replace(_estimate(own, None, settings), louder=louder, of_angle=found.of_angle)


def _louder(groups: Sequence[Group], noise: Noise, settings: NoiseSettings) -> dict[str, float]:
    """By run, how many times its sensor's noise is that of all of them; empty where chance would do (Bartlett 1937)."""
    looks, sensor = np.geomspace(*settings.louder_span, settings.louder_looks), noise.sensor.value
    time_s = noise.torque_s.value or settings.times_s[0]
    axes = [np.array([time_s]), sensor * looks, np.array([[noise.torque_pct.value]])]
    by_run: dict[str, list[Group]] = {}
    for group in groups:
        by_run.setdefault(group.run, []).append(group)
    louder, gain = {}, 0.0
    for run, parts in by_run.items():
        profile = deviances(merged(parts), axes, LEAST_VARIANCE * sensor**2, settings)[0, :, 0]
        louder[run] = _ranged(looks, profile, settings).value
        gain += float(profile[len(looks) // 2] - profile.min())
    free = len(by_run) - 1
    by_chance = chdtri(free, settings.louder_chance) if free else np.inf
    return louder if gain > by_chance * settings.interval_deviance / CHI_SQUARED_95 else {}


def _estimate(groups: Sequence[Group], sensor: float | None, settings: NoiseSettings) -> Noise:
    """The noise of groups, each as loud as it says."""
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
    axes = [times, sensors, np.tile(torques, (len(times), 1))]
    # The sensor's noise is known best by far: found first, so that no torque makes up for a coarse look at it. Then the
    # torque at each time: a time whose torque was looked at coarsely would seem unlikely.
    for zoom in range(settings.sensor_zooms + 1 + settings.zooms):
        looks, closer = deviances(groups, axes, least, settings), axes[0]
        if zoom > settings.sensor_zooms:
            closer = _spread(*_near(axes[0], looks.min(axis=(1, 2)), settings), len(axes[0]))
        if zoom >= settings.sensor_zooms:
            axes[2] = _closer_torques(closer, axes[0], axes[2], looks.min(axis=1), settings)
        axes[0], axes[1] = closer, _spread(*_near(axes[1], looks.min(axis=(0, 2)), settings), len(axes[1]))
    looks = deviances(groups, axes, least, settings)
    best = np.unravel_index(int(np.argmin(looks)), looks.shape)
    times, torques, profile = _finer(axes[0], axes[2], looks.min(axis=1))
    time = _ranged(times, profile.min(axis=1), settings)
    time = time if axes[2][best[0], best[2]] > 0.0 else Ranged(0.0, *settings.times_s)
    torque = _ranged(*_across(torques, profile), settings)
    own = _ranged(axes[1], looks.min(axis=(0, 2)), settings)
    return Noise(own, torque, time, float(looks.min()), samples, likely=_likely(looks, axes, settings))


def _likely(looks: np.ndarray, axes: Sequence[np.ndarray], settings: NoiseSettings) -> np.ndarray:
    """Draws (k, 3) of sensor, torque and its time, as likely as the data say, from looks (times, sensors, torques)
    around their best: at even steps of the likelihood summed up (systematic sampling).
    """
    counts = CHI_SQUARED_95 / settings.interval_deviance
    apart = np.gradient(axes[2], axis=1)[:, None, :]
    chance = np.cumsum((apart * np.exp(-0.5 * counts * (looks - looks.min()))).ravel())
    steps = (np.arange(settings.likely) + 0.5) / settings.likely * chance[-1]
    times, sensors, torques = np.unravel_index(np.searchsorted(chance, steps), looks.shape)
    return np.column_stack([axes[1][sensors], axes[2][times, torques], axes[0][times]])


def _closer_torques(
    closer: np.ndarray, times: np.ndarray, torques: np.ndarray, profile: np.ndarray, settings: NoiseSettings
) -> np.ndarray:
    """The torques (n, m) of some ``closer`` times (n), around what is near the least of a profile (n, m) at ``times``
    (n) and their ``torques`` (n, m).

    Each time has torques of its own: data that tell how far a torque wanders in a second leave a ridge, on which a
    longer time goes with a larger torque. It is narrower than the steps of a grid that all times share.
    """
    ends = [_near(x, row, settings) for x, row in zip(torques, profile, strict=True)]
    lows, highs = (np.interp(np.log(closer), np.log(times), end).tolist() for end in zip(*ends, strict=True))
    return np.array([_spread(low, high, torques.shape[1]) for low, high in zip(lows, highs, strict=True)])


def _finer(times: np.ndarray, *rows: np.ndarray) -> list[np.ndarray]:
    """Times (n) and what goes with each (n, m), with more of them between, by cubic splines of even steps."""
    looks = np.arange(len(times))
    between = np.linspace(0.0, looks[-1], BETWEEN * looks[-1] + 1)
    return [np.exp(np.interp(between, looks, np.log(times))), *(CubicSpline(looks, y)(between) for y in rows)]


def _across(torques: np.ndarray, profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Torques (k) and the least deviance of each over all times, from rows of both (n, m)."""
    grid = _spread(float(torques.min()), float(torques.max()), BETWEEN * torques.shape[1])
    return grid, np.min([np.interp(grid, x, y) for x, y in zip(torques, profile, strict=True)], axis=0)


def _near(x: np.ndarray, profile: np.ndarray, settings: NoiseSettings) -> tuple[float, float]:
    """Ends of what is near the least of a profile (n), a step more on either side."""
    near = np.flatnonzero(profile <= profile.min() + settings.near_deviance)
    return float(x[max(near[0] - 1, 0)]), float(x[min(near[-1] + 1, len(x) - 1)])


def _spread(low: float, high: float, n: int) -> np.ndarray:
    """So many values from one end to the other, by even ratios where none is nil."""
    return np.asarray(np.geomspace(low, high, n) if low > 0.0 else np.linspace(0.0, high, n))


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
