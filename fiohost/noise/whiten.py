"""Windows whitened by the covariance of the noise, and whether what is left is white."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import solve_triangular

from fiohost.noise import covariance
from fiohost.noise.estimate import Motor, Noise
from fiohost.noise.settings import SETTINGS, NoiseSettings


@dataclass(frozen=True)
class _Alike:
    """Windows of one covariance: their first samples (m), what whitens a window (n, n), and the logarithm of the
    covariance's determinant outside what its start can take.
    """

    firsts: np.ndarray
    whitens: np.ndarray = field(repr=False)
    log_determinant: float


class Whitener:
    """Whitens series over a record's windows, and takes out of each what its own angle and speed at its beginning could
    take: what is left of a true model has unit variance outside these.
    """

    def __init__(self, alike: Sequence[_Alike]) -> None:
        self._alike = alike
        self.log_determinant = sum(len(part.firsts) * part.log_determinant for part in alike)

    @classmethod
    def of(
        cls,
        times_s: np.ndarray,
        moving: np.ndarray,
        weights: np.ndarray,
        firsts: np.ndarray,
        lasts: np.ndarray,
        motor: Motor,
        noise: Noise,
    ) -> Whitener:
        """For windows of samples ``firsts`` to ``lasts`` (m each) at ``times_s`` (n); ``moving`` (n) says how the shaft
        moves from a sample to the next, ``weights`` (n) by what counts that err alike are weighed together.
        """
        places: dict[bytes, list[int]] = {}
        spans: dict[bytes, int] = {}
        for a, b in zip(firsts.tolist(), lasts.tolist(), strict=True):
            steps = np.rint(np.diff(times_s[a:b]) / motor.step_s * 20.0).astype(np.int32)
            key = steps.tobytes() + moving[a:b].tobytes() + weights[a:b].tobytes()
            places.setdefault(key, []).append(a)
            spans[key] = b
        alike = []
        for key, found in places.items():
            a, b = found[-1], spans[key]
            alike.append(_Alike(np.array(found), *_whitening(times_s[a:b], moving[a:b], weights[a:b], motor, noise)))
        return cls(alike)

    def apply(self, series: np.ndarray) -> np.ndarray:
        """A series (n) or several (n, k) of the record, whitened; zero outside the windows."""
        out = np.zeros_like(series, dtype=np.float64)
        for part in self._alike:
            n = len(part.whitens)
            rows = part.firsts[None, :] + np.arange(n)[:, None]
            taken = series[rows]  # (n, m) or (n, m, k)
            out[rows] = (part.whitens @ taken.reshape(n, -1)).reshape(taken.shape)
        return out


def _whitening(
    times_s: np.ndarray, moving: np.ndarray, weights: np.ndarray, motor: Motor, noise: Noise
) -> tuple[np.ndarray, float]:
    n = len(times_s)
    if n < 3:
        return np.zeros((n, n)), 0.0  # its own start takes all of it
    own = covariance.counts(n, motor.quantum, motor.kind) / np.outer(weights, weights)
    own += noise.sensor.value**2 * np.eye(n)
    if noise.torque_pct.value > 0.0 and moving.any():
        acts = covariance.response(times_s, moving, motor.gain, motor.tau_s, motor.kind) * noise.torque_pct.value
        own = own + acts @ covariance.torque(times_s, noise.torque_s.value) @ acts.T
    own[np.diag_indices(n)] += 1e-9 * float(np.trace(own)) / n + 1e-300
    root = np.linalg.cholesky(own)
    inverse = solve_triangular(root, np.eye(n), lower=True, check_finite=False)
    starts = covariance.starts(times_s, moving, motor.tau_s, motor.kind)
    columns, triangle = np.linalg.qr(inverse @ starts)
    sizes = np.abs(np.diag(triangle)) / np.maximum(np.abs(np.diag(np.linalg.qr(starts)[1])), 1e-300)
    taken = 2.0 * float(np.log(np.maximum(sizes, 1e-300)).sum())  # restricted likelihood (Harville 1974)
    determinant = 2.0 * float(np.log(np.diag(root)).sum()) + taken
    return np.asarray(inverse - columns @ (columns.T @ inverse)), determinant


def unevenness(
    whitened: Sequence[np.ndarray], edges: Sequence[np.ndarray], settings: NoiseSettings = SETTINGS
) -> float:
    """How far whitened residuals (n each) are from white: their autocorrelations within windows of ``edges`` (m + 1
    each), pooled over all windows, squared and summed over lags (Box and Pierce 1970).

    No window counts for more than some standard deviations: one in which the shaft stuck, and the model's did not, says
    nothing of all the others.
    """
    sums, windows = np.zeros(settings.lags), 0
    for series, ends in zip(whitened, edges, strict=True):
        for a, b in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
            part = series[a:b]
            power = float(part @ part)
            if len(part) <= settings.lags or power <= 0.0:
                continue
            along = np.array([float(part[k + 1 :] @ part[: -k - 1]) for k in range(settings.lags)]) / power
            most = settings.most_of_a_window
            sums += np.clip(np.sqrt(len(part)) * along, -most, most)
            windows += 1
    return float(np.sum(sums**2)) / max(windows, 1)


def is_white(value: float, draws: Sequence[float], settings: NoiseSettings = SETTINGS) -> bool:
    """Whether an unevenness is no larger than that of bootstrap samples, at 1 %: their logarithm is about normal,
    and its level is drawn from them.
    """
    logs = np.log(np.maximum(draws, 1e-300))
    spread = float(logs.std(ddof=1)) * (1.0 + 1.0 / len(logs)) ** 0.5
    return bool(np.log(max(value, 1e-300)) <= float(logs.mean()) + settings.white_sigmas * spread)
