"""Over how many rows a speed was taken as the difference of two counts, by how its readings err."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fiohost.importing.raw import FloatArray

BLOCK, CURVE = 16, 2  # rows looked at together, a curve of this degree taken off: what a motor does slowly is no error
QUIET = 2.0  # rms, in steps, of a block that shows errors alone
MOST = 3.0  # no block says more, as a logarithm of odds: a kink is no error of either kind
SURE = 1.5  # logarithm of odds of a block, on average


@lru_cache(maxsize=2)
def _shapes(rows: int) -> tuple[FloatArray, FloatArray]:
    """Directions (n, m) outside a curve through a block in which differences of white errors over so many rows are
    apart, and their variances (m) for errors of one.
    """
    free = np.linalg.svd(np.vander(np.linspace(-1.0, 1.0, BLOCK), CURVE + 1))[0][:, CURVE + 1 :]
    difference = np.eye(BLOCK, BLOCK + rows, rows) - np.eye(BLOCK, BLOCK + rows)
    values, vectors = np.linalg.eigh(free.T @ difference @ difference.T @ free)
    return free @ vectors, values


def around_the_row(speeds: FloatArray, step: float) -> bool:
    """Whether speeds (n) err as differences from the row before to the next do, as numpy's and MATLAB's ``gradient``
    gives them, rather than as those since the row before: what one lacks the next but one has.
    """
    blocks = speeds[: len(speeds) // BLOCK * BLOCK].reshape(-1, BLOCK).T
    blocks = blocks[:, np.ptp(blocks, axis=0) > 0.0]
    odds = np.zeros(blocks.shape[1])
    quiet = np.ones(blocks.shape[1], dtype=bool)
    for rows, sign in ((1, -1.0), (2, 1.0)):
        directions, variances = _shapes(rows)
        powers = (directions.T @ blocks) ** 2
        quiet &= powers.sum(axis=0) <= len(variances) * (QUIET * step) ** 2
        with np.errstate(divide="ignore"):
            likely = len(variances) * np.log((powers / variances[:, None]).sum(axis=0)) + np.log(variances).sum()
        odds -= 0.5 * sign * likely
    odds = odds[quiet & np.isfinite(odds)]
    return bool(len(odds)) and float(np.clip(odds, -MOST, MOST).mean()) > SURE
