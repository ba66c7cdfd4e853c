"""What several figures reach by chance at once.

One with many directions reaches more by chance than one with a single size, so each has a level of its own: cube roots
of squares are about normal (Wilson and Hilferty 1931), and the 99 % point is that of the largest of them all, in
standard deviations.
"""

from __future__ import annotations

import numpy as np


def levels_of(found: np.ndarray, sigmas: float) -> np.ndarray:
    """What each of several figures reaches by chance (figures), from those of bootstrap samples (draws, figures);
    ``sigmas`` from mean to 99 % point of a Gumbel distribution.
    """
    roots = np.cbrt(found)
    mean, spread = roots.mean(axis=0), roots.std(axis=0, ddof=1)
    traces = spread > 0.0
    if not traces.any():
        return np.zeros(found.shape[1])
    best = ((roots - mean)[:, traces] / spread[traces]).max(axis=1)
    top = float(best.mean() + sigmas * best.std(ddof=1))
    return np.where(traces, (mean + top * spread) ** 3, 0.0)
