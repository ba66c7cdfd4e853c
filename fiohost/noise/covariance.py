"""Covariances of what a random torque does to the output of a first-order motor, exactly at the sample times.

The motor is ``tau w' + w = K d``; the torque d, in percent of duty, is held from sample to sample and is an
Ornstein-Uhlenbeck process of standard deviation sigma_p and correlation time tau_d (Uhlenbeck and Ornstein 1930).
While the shaft stands, a torque does nothing and what it did to the speed is gone. Where it turns against dry friction,
what a torque did to its speed changes by how the acceleration does: it turns sooner or later, and from then on another
torque acts (the saltation of Aizerman and Gantmakher 1958).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiohost.motor.compiled import compiled, inlined

ANGLE, SPEED, MEAN_SPEED = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Movement:
    """How a shaft moves from each sample to the next: the lag with which what is off in its speed dies away (``lag_s``,
    n; 0 where it stands; long where it coasts), and which share of that it keeps beside (``keeps``, n).
    """

    lag_s: np.ndarray
    keeps: np.ndarray

    @classmethod
    def steady(cls, samples: int, tau_s: float) -> Movement:
        """Driven on all the way."""
        return cls(np.full(samples, tau_s), np.ones(samples))

    @property
    def stands(self) -> np.ndarray:
        """Whether (n) the shaft stands."""
        return np.asarray(self.lag_s <= 0.0)


def response(times_s: np.ndarray, moving: Movement, gain: float, tau_s: float, kind: int) -> np.ndarray:
    """Output (n, n) at each time, in its unit, of a torque of 1 % from each sample to the next.

    ``times_s`` (n); ``gain`` in the output's unit per second and percent, or per percent of a speed; ``kind`` of
    output: angle, speed or mean speed.
    """
    n = len(times_s)
    speed, angle = np.zeros((n, n)), np.zeros((n, n))
    _responses(times_s, moving.lag_s, moving.keeps, gain, tau_s, angle, speed)
    return _seen(times_s, angle, speed, kind)


@inlined
def way(step, lag):  # type: ignore[no-untyped-def]
    """How far a shaft of unit speed goes in a ``step``."""
    return -lag * np.expm1(-step / lag)


@compiled
def _responses(times_s, lags, keeps, gain, tau_s, angle, speed):  # type: ignore[no-untyped-def]
    for k in range(len(times_s) - 1):
        step, lag = times_s[k + 1] - times_s[k], lags[k]
        for i in range(k):
            angle[k + 1, i] = angle[k, i]
        if lag > 0.0:
            goes = way(step, lag)
            full = gain * lag / tau_s
            for i in range(k):
                angle[k + 1, i] += 0.5 * (1.0 + keeps[k]) * goes * speed[k, i]
                speed[k + 1, i] = keeps[k] * (1.0 - goes / lag) * speed[k, i]
            angle[k + 1, k] = full * (step - goes)
            speed[k + 1, k] = full * goes / lag


@compiled
def _follows(times_s, lags, keeps, angle, speed):  # type: ignore[no-untyped-def]
    for k in range(len(times_s) - 1):
        angle[k + 1], lag = angle[k], lags[k]
        if lag > 0.0:
            goes = way(times_s[k + 1] - times_s[k], lag)
            angle[k + 1] += 0.5 * (1.0 + keeps[k]) * goes * speed[k]
            speed[k + 1] = keeps[k] * (1.0 - goes / lag) * speed[k]


def starts(times_s: np.ndarray, moving: Movement, kind: int) -> np.ndarray:
    """Columns (n, 1..2) by which the output follows the angle and the speed at the first sample."""
    speed, angle = np.zeros((len(times_s), 1)), np.zeros((len(times_s), 1))
    speed[0] = 1.0
    _follows(times_s, moving.lag_s, moving.keeps, angle[:, 0], speed[:, 0])
    by_speed = _seen(times_s, angle, speed, kind)
    if kind == MEAN_SPEED:  # the first was measured before the window began
        return np.column_stack((by_speed, np.arange(len(times_s)) == 0))
    return np.column_stack((np.ones(len(times_s)), by_speed)) if kind == ANGLE else by_speed


def _seen(times_s: np.ndarray, angle: np.ndarray, speed: np.ndarray, kind: int) -> np.ndarray:
    if kind == ANGLE:
        return angle
    if kind == SPEED:
        return speed
    mean = np.zeros_like(angle)
    mean[1:] = np.diff(angle, axis=0) / np.diff(times_s)[:, None]
    return mean


def torque(times_s: np.ndarray, time_s: float) -> np.ndarray:
    """Correlation (n, n) of a torque of correlation time ``time_s``."""
    return np.asarray(np.exp(-np.abs(times_s[:, None] - times_s[None, :]) / time_s))


def counts(n: int, quantum: float, kind: int) -> np.ndarray:
    """Covariance (n, n) of the errors that counts make of a moving shaft.

    Each reading errs evenly within a count; what a mean speed taken from counts lacks, the next one has.
    """
    own = quantum**2 / 12.0
    if kind != MEAN_SPEED:
        return own * np.eye(n)
    return own * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))


def outside(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis (n, n - rank) of what the columns (n, q) do not reach."""
    left, sizes, _ = np.linalg.svd(columns, full_matrices=True)
    rank = int(np.sum(sizes > 1e-9 * max(float(sizes.max(initial=0.0)), 1e-300)))
    return np.asarray(left[:, rank:])
