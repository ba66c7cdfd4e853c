"""Jitter and limit cycles of a loop that should rest: how often the duty changes its sign, how far the shaft swings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiohost.errors import DataError

RESTS_BELOW_PER_S = 1.0
JITTER_COUNTS = 2.0  # a swing of so many counts or fewer is jitter, of more a limit cycle
REST, JITTER, LIMIT_CYCLE = "at rest", "jitter", "limit cycle"


@dataclass(frozen=True)
class Jitter:
    """Reversals of the duty a second, swing of the angle from peak to peak, and which of the three it is.

    A limit cycle's ``frequency_hz`` is half its reversals; 0 where the loop rests.
    """

    reversals_per_s: float
    swing_deg: float
    kind: str

    @property
    def frequency_hz(self) -> float:
        return 0.5 * self.reversals_per_s if self.kind != REST else 0.0


def reversals(duty_pct: np.ndarray) -> int:
    """How often a duty (n) changes its sign, zeros passed over."""
    signs = np.sign(duty_pct)
    signs = signs[signs != 0.0]
    return int(np.count_nonzero(np.diff(signs)))


def find_jitter(time_s: np.ndarray, duty_pct: np.ndarray, angle_deg: np.ndarray, quantum_deg: float) -> Jitter:
    """Judge a piece of a run (n) during which the reference stands still and the response should be over.

    Raises DataError for fewer than two samples.
    """
    if len(time_s) < 2:
        raise DataError("jitter shows in two samples or more")
    rate = reversals(duty_pct) / float(time_s[-1] - time_s[0])
    swing = float(np.ptp(angle_deg))
    if rate < RESTS_BELOW_PER_S:
        return Jitter(rate, swing, REST)
    return Jitter(rate, swing, JITTER if swing <= JITTER_COUNTS * quantum_deg + 1e-9 else LIMIT_CYCLE)
