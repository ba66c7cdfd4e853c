"""The second-order form of a P-controlled motor, and its fit from reference to angle.

With G(s) = K / (s (tau s + 1)) and C(s) = kp the loop is T(s) = wn^2 / (s^2 + 2 zeta wn s + wn^2) with
wn^2 = kp K / tau and 2 zeta wn = 1 / tau (INC451 lab 2, Eq. 2.7). The fit is an output-error one, which is what a
prediction-error fit is without a model of the noise: a static gain, wn and zeta, no zero, the state at the start free.
"""

from __future__ import annotations

import cmath
from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, log, pi, sqrt

import numpy as np
from scipy.optimize import least_squares

from fiohost.errors import DataError
from fiohost.estimation.intervals import sandwich

STARTS = tuple((omega, zeta) for omega in (3.0, 10.0, 30.0) for zeta in (0.3, 0.8))
OMEGA_RANGE, ZETA_RANGE = (0.05, 2000.0), (0.005, 20.0)
DIFFERENCE = 1e-4
SHORTEST = 20
LEAST_OVERSHOOT_PCT = 0.5  # below it, zeta above 0.86, an overshoot and its time say next to nothing


def open_loop(zeta: float, omega_n: float, kp: float = 1.0) -> tuple[float, float]:
    """K (deg/s per percent) and tau (s) of the motor in a loop with these zeta and wn (rad/s) at ``kp`` (percent/deg).

    Eq. 2.7 solved for K and tau.
    """
    return omega_n / (2.0 * zeta * kp), 1.0 / (2.0 * zeta * omega_n)


def closed_loop(gain: float, tau_s: float, kp: float = 1.0) -> tuple[float, float]:
    """zeta and wn (rad/s) of the loop around a motor of K (deg/s per percent) and tau (s): Eq. 2.7."""
    omega_n = sqrt(kp * gain / tau_s)
    return 1.0 / (2.0 * tau_s * omega_n), omega_n


def from_overshoot(overshoot_pct: float, peak_s: float) -> tuple[float, float]:
    """zeta and wn (rad/s) of an underdamped second-order response with this overshoot and peak time.

    Golnaraghi and Kuo, Automatic Control Systems, section 7-5. Raises DataError where hardly anything overshoots.
    """
    if not (LEAST_OVERSHOOT_PCT <= overshoot_pct < 100.0 and peak_s > 0.0):
        raise DataError(f"an overshoot of {overshoot_pct:.3g} % at {peak_s:.3g} s is not that of an underdamped loop")
    slope = -log(overshoot_pct / 100.0)
    zeta = slope / sqrt(pi**2 + slope**2)
    return zeta, pi / (peak_s * sqrt(1.0 - zeta**2))


def overshoot_pct(zeta: float) -> float:
    """Overshoot of the second-order form in percent; 0 from critical damping on."""
    return 100.0 * exp(-pi * zeta / sqrt(1.0 - zeta**2)) if zeta < 1.0 else 0.0


@dataclass(frozen=True)
class LoopRecord:
    """One closed-loop run on an even grid: ``ref_deg`` as it acts at each tick (n), ``y_deg`` (n, NaN for no row)."""

    tick_s: float
    ref_deg: np.ndarray
    y_deg: np.ndarray


@dataclass(frozen=True)
class SecondOrder:
    """``gain wn^2 / (s^2 + 2 zeta wn s + wn^2)`` as fitted: covariance (3, 3) in the order wn, zeta, gain.

    ``simulated`` (n each) are the responses of the records, ``fit_pct`` is 100 (1 - |y - s| / |y - mean y|) over all.
    """

    omega_n_rad_s: float
    zeta: float
    gain: float
    covariance: np.ndarray
    simulated: tuple[np.ndarray, ...]
    rms_deg: float
    fit_pct: float


def _held(omega: float, zeta: float, tick: float) -> tuple[np.ndarray, np.ndarray]:
    """State matrix (2, 2) and input column (2) of the form over a tick with its reference held, exactly."""
    damped = cmath.sqrt(complex(1.0 - zeta**2)) * omega
    turned = damped * tick
    cosine = cmath.cos(turned).real
    sine = (cmath.sin(turned) / damped).real if abs(turned) > 1e-9 else tick
    fading = zeta * omega
    a = exp(-fading * tick) * np.array([[cosine + fading * sine, sine], [-(omega**2) * sine, cosine - fading * sine]])
    return a, np.array([1.0 - a[0, 0], -a[1, 0]])


def _columns(record: LoopRecord, omega: float, zeta: float) -> np.ndarray:
    """Responses (n, 3): to the reference from zero state, to an angle of one at the start, to a speed of one."""
    from scipy.signal import lfilter  # takes a second to load

    a, b = _held(omega, zeta, record.tick_s)
    past = [1.0, -(a[0, 0] + a[1, 1]), a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]]
    impulse = np.zeros(len(record.ref_deg))
    impulse[0] = 1.0
    driven = lfilter([0.0, b[0], a[0, 1] * b[1] - a[1, 1] * b[0]], past, record.ref_deg)
    return np.column_stack((driven, lfilter([1.0, -a[1, 1]], past, impulse), lfilter([0.0, a[0, 1]], past, impulse)))


def respond(record: LoopRecord, omega: float, zeta: float) -> np.ndarray:
    """Response (n) of the form with gain 1 to a record's reference, from rest where the record begins."""
    first = float(record.y_deg[np.isfinite(record.y_deg)][0])
    return np.asarray(_columns(record, omega, zeta) @ np.array([1.0, first, 0.0]))


class _Problem:
    """All records at once; for each wn and zeta the gain and the states at the start follow linearly."""

    def __init__(self, records: Sequence[LoopRecord]) -> None:
        self.records = records
        self.seen = [np.isfinite(r.y_deg) for r in records]
        self.y = np.concatenate([r.y_deg[s] for r, s in zip(records, self.seen, strict=True)])

    def columns(self, omega: float, zeta: float) -> np.ndarray:
        """Linear columns (samples, 1 + 2 records): the gain's, then angle and speed at the start of each record."""
        out = np.zeros((len(self.y), 1 + 2 * len(self.records)))
        row = 0
        for i, (record, seen) in enumerate(zip(self.records, self.seen, strict=True)):
            part = _columns(record, omega, zeta)[seen]
            out[row : row + len(part), 0] = part[:, 0]
            out[row : row + len(part), 1 + 2 * i : 3 + 2 * i] = part[:, 1:]
            row += len(part)
        return out

    def solve(self, omega: float, zeta: float) -> tuple[np.ndarray, np.ndarray]:
        """Linear parameters and what they leave of the data."""
        columns = self.columns(omega, zeta)
        linear, *_ = np.linalg.lstsq(columns, self.y, rcond=None)
        return linear, self.y - columns @ linear

    def split(self, values: np.ndarray) -> list[np.ndarray]:
        return np.split(values, np.cumsum([int(s.sum()) for s in self.seen])[:-1])


def fit_second_order(records: Sequence[LoopRecord]) -> SecondOrder:
    """Fit the form to closed-loop records, from several starts. Raises DataError where they are too short or still."""
    problem = _Problem(records)
    if len(problem.y) < SHORTEST or not np.ptp(problem.y) > 0.0:
        raise DataError("a second-order form cannot be fitted: the logs are too short, or nothing moves after a step")

    def residual(at: np.ndarray) -> np.ndarray:
        return problem.solve(exp(at[0]), exp(at[1]))[1]

    bounds = tuple(np.log(np.array(pair)) for pair in zip(OMEGA_RANGE, ZETA_RANGE, strict=True))
    costs = [(float(np.sum(residual(np.log(start)) ** 2)), start) for start in STARTS]
    best = min(
        (least_squares(residual, np.log(start), bounds=bounds) for _, start in sorted(costs)[:2]),
        key=lambda found: float(found.cost),
    )
    omega, zeta = (exp(float(value)) for value in best.x)
    linear, left = problem.solve(omega, zeta)
    covariance = _covariance(problem, omega, zeta, linear, left)
    whole = [
        _columns(record, omega, zeta) @ np.concatenate((linear[:1], linear[1 + 2 * i : 3 + 2 * i]))
        for i, record in enumerate(records)
    ]
    spread = problem.y - problem.y.mean()
    return SecondOrder(
        omega, zeta, float(linear[0]), covariance, tuple(whole),
        float(np.sqrt(np.mean(left**2))), float(100.0 * (1.0 - np.linalg.norm(left) / np.linalg.norm(spread))),
    )  # fmt: skip


def _covariance(problem: _Problem, omega: float, zeta: float, linear: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Covariance (3, 3) of wn, zeta and gain by the sandwich over blocks of time, the starts projected out."""
    columns = problem.columns(omega, zeta)
    model = columns @ linear
    by_omega = (problem.columns(omega * (1.0 + DIFFERENCE), zeta) @ linear - model) / (omega * DIFFERENCE)
    by_zeta = (problem.columns(omega, zeta * (1.0 + DIFFERENCE)) @ linear - model) / (zeta * DIFFERENCE)
    basis, _ = np.linalg.qr(columns[:, 1:])
    wanted = np.column_stack((by_omega, by_zeta, columns[:, 0]))
    wanted -= basis @ (basis.T @ wanted)
    found, _ = sandwich(problem.split(left), [np.asarray(part) for part in problem.split(wanted)])
    return found
