"""Windows whitened by the noise, and whether what is left is white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiohost.noise.average import Average
from fiohost.noise.covariance import Movement
from fiohost.noise.estimate import Noise
from fiohost.noise.innovations import LINKS, STATES, filters, follow, innovations
from fiohost.noise.likelihood import Motor
from fiohost.noise.settings import SETTINGS, NoiseSettings

# Of fewer samples a window's own start takes all.
FEWEST = 3


class Whitener:
    """Whitens series over the samples (k) of a record's windows, and takes out of each window what its own angle and
    speed at its beginning could take: what is left of a true model has unit variance outside these. ``sure`` (n) is one
    over the variance of each reading from a known start.

    For windows of samples ``firsts`` to ``lasts`` (m each) at ``times_s`` (n), in which the shaft moves as ``moving``
    says; ``weights`` (n) are those by which counts that err alike are weighed together, ``average`` is what the logger
    smoothed the readings by, which is undone.
    """

    def __init__(
        self,
        times_s: np.ndarray,
        moving: Movement,
        weights: np.ndarray,
        firsts: np.ndarray,
        lasts: np.ndarray,
        motor: Motor,
        noise: Noise,
        average: Average | None = None,
    ) -> None:
        self._average, self._begins = average, np.cumsum(lasts - firsts) - (lasts - firsts)
        long, all_lengths = lasts - firsts >= FEWEST, (lasts - firsts).astype(np.int64)
        lengths, self._samples = all_lengths[long], int(all_lengths.sum())
        places = np.cumsum(lengths) - lengths
        within = np.arange(int(lengths.sum())) - np.repeat(places, lengths)
        rows = np.repeat(firsts[long].astype(np.int64), lengths) + within
        self._at = np.repeat((np.cumsum(all_lengths) - all_lengths)[long], lengths) + within
        n = len(rows)
        begins = np.zeros(n, dtype=bool)
        begins[places] = True
        self._weights, self._links = weights[rows], np.zeros((n, LINKS))
        torque = noise.torque_pct.value**2
        sensor, own_count, count = replace(motor, of_angle=noise.of_angle).sensed(np.array(noise.sensor.value))
        at_start = min(noise.torque_pct.value, SETTINGS.most_at_start_pct) ** 2
        follow(
            times_s, moving.lag_s, moving.keeps, rows, begins, motor.gain, motor.tau_s, motor.kind,
            noise.torque_s.value, self._links,
        )  # fmt: skip
        own = np.full(n, float(sensor))
        own += own_count / self._weights**2
        self._gains, self._scales, sure = np.zeros((n, STATES)), np.zeros(n), np.ones(n)
        determinant = filters(
            self._weights, begins, moving.stands[rows], self._links, own, float(count), torque, at_start,
            motor.kind, motor.tau_s, self._gains, self._scales, sure, np.zeros((STATES, STATES)),
        )  # fmt: skip
        self.log_determinant = float(determinant)
        self.sure = np.ones(len(times_s))
        self.sure[rows] = sure

    def apply(self, series: np.ndarray) -> np.ndarray:
        """A series (k) or several (k, c) of the windows' samples, whitened; zero in windows of too few."""
        if len(series) != self._samples:
            raise ValueError(f"{len(series)} samples of windows that hold {self._samples}")
        columns = np.ascontiguousarray(series, dtype=np.float64).reshape(len(series), -1)
        if self._average:
            columns = self._average.undone(columns, self._begins)
        out, states = np.zeros_like(columns), np.zeros((STATES, columns.shape[1]))
        innovations(columns, self._at, self._links, self._weights, self._gains, self._scales, states, out)
        return out.reshape(series.shape)


def unevenness(
    whitened: Sequence[np.ndarray], edges: Sequence[np.ndarray], settings: NoiseSettings = SETTINGS
) -> float:
    """How far whitened residuals (n each) are from white: their autocorrelations within windows of ``edges`` (m + 1
    each), pooled over all windows, squared and summed over lags (Box and Pierce 1970).

    No window counts for more than some standard deviations: one in which the shaft stuck, and the model's did not, says
    nothing of all the others. One that leaves less than all do in the mean counts for less: of a shaft that rests only
    rounding is left, and that is not white.
    """
    ends = [zip(e[:-1].tolist(), e[1:].tolist(), strict=True) for e in edges]
    parts = [s[a:b] for s, pairs in zip(whitened, ends, strict=True) for a, b in pairs if b - a > settings.lags]
    powers = [float(part @ part) for part in parts]
    least = sum(powers) / max(sum(map(len, parts)), 1)
    sums, windows, most = np.zeros(settings.lags), 0, settings.most_of_a_window
    for part, power in zip(parts, powers, strict=True):
        if power > 0.0:
            along = np.array([float(part[k + 1 :] @ part[: -k - 1]) for k in range(settings.lags)])
            sums += np.clip(np.sqrt(len(part)) * along / max(power, least * len(part)), -most, most)
            windows += 1
    return float(np.sum(sums**2)) / max(windows, 1)


def is_white(value: float, draws: Sequence[float], settings: NoiseSettings = SETTINGS) -> bool:
    """Whether an unevenness is no larger than that of bootstrap samples, at 1 %: their logarithm is about normal,
    and its level is drawn from them.
    """
    logs = np.log(np.maximum(draws, 1e-300))
    spread = float(logs.std(ddof=1)) * (1.0 + 1.0 / len(logs)) ** 0.5
    return bool(np.log(max(value, 1e-300)) <= float(logs.mean()) + settings.white_sigmas * spread)
