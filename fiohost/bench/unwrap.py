"""Encoder counts that wrap become a continuous angle: the shortest path, and where that is not safe."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SAFE_TURN = 0.45  # of a turn between two readings: up to here the shortest path is taken as certain


class Unwrapper:
    """Unwraps one reading at a time, for the tick loop: ``update(pos)`` returns the total count.

    Exact integers; the first reading is taken as it is, so that the angle starts at POS/2. Shortest path: between two
    readings the shaft must turn less than half a revolution (at 170 rpm that is 176 ms).
    """

    def __init__(self, counts_per_rev: int) -> None:
        self._turn = counts_per_rev
        self._half = counts_per_rev // 2
        self._total: int | None = None

    def update(self, pos: int) -> int:
        if self._total is None:
            self._total = pos
        else:
            self._total += (pos - self._total + self._half) % self._turn - self._half
        return self._total


def unwrap_counts(pos: NDArray[np.float64], counts_per_rev: int) -> NDArray[np.float64]:
    """Total counts of readings *pos*, shape (rows,), by the shortest path, starting at ``pos[0]``."""
    return np.asarray(np.concatenate((pos[:1], pos[0] + np.cumsum(_shortest(pos, counts_per_rev)))), dtype=np.float64)


def _shortest(pos: NDArray[np.float64], counts_per_rev: int) -> NDArray[np.float64]:
    """Counts from each reading to the next, shape (rows - 1,), at most half a turn either way."""
    half = counts_per_rev // 2
    steps = np.diff(pos)
    turns = (steps + half) / counts_per_rev  # whole ones are taken off: exact, and much faster than a remainder
    np.floor(turns, out=turns)
    turns *= -counts_per_rev
    turns += steps
    return turns


def ambiguous_steps(
    pos: NDArray[np.float64], time_s: NDArray[np.float64], sample_time_s: float, counts_per_rev: int
) -> NDArray[np.int64]:
    """Indices i where the way from reading i to i+1 is not certain.

    Either the step itself is near half a turn, or ticks are missing there and the speed on either side of the gap
    would carry the shaft near half a turn.
    """
    if pos.size < 2:
        return np.zeros(0, dtype=np.int64)
    steps = _shortest(pos, counts_per_rev)
    np.abs(steps, out=steps)
    limit = SAFE_TURN * counts_per_rev
    far = steps > limit
    gaps_s = np.diff(time_s)
    gaps = np.flatnonzero(gaps_s > 1.5 * sample_time_s)
    speeds = np.zeros(gaps.size)  # counts/s, of the step before and after each gap where no tick is missing
    for beside in (gaps - 1, gaps + 1):
        is_there = (beside >= 0) & (beside < steps.size)
        at = beside[is_there]
        is_whole = gaps_s[at] < 1.5 * sample_time_s
        speeds[is_there] = np.maximum(speeds[is_there], np.where(is_whole, steps[at] / gaps_s[at], 0.0))
    far[gaps] |= speeds * gaps_s[gaps] > limit
    return np.flatnonzero(far)
