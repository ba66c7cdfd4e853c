"""Speeds that were taken from the row before to the next, as ``gradient`` of numpy and MATLAB gives them, and the mean
speeds since the row before that they were made of.
"""

from __future__ import annotations

import numpy as np

from fiohost.importing.raw import FloatArray

FEWEST = 50  # rows with motion, to tell by
OFF_STEP = 0.2  # share of a step by which a reading may be off one
ROUGHER = 1.5  # times as rough as the readings, and two of their steps, is what was never so made up: 4 to 60 times


def since_the_row_before(speeds: FloatArray, step: float) -> FloatArray | None:
    """Mean speeds since the row before (n) of a counter of which ``speeds`` (n, in steps of half a count a row) are
    those from the row before to the next; None where they are of no such steps.

    They tell every other count from the one two rows before. How far both series are apart is where neighbours agree.
    """
    times = np.rint(speeds / step)
    if len(times) < FEWEST or float(np.quantile(np.abs(speeds / step - times), 0.99)) > OFF_STEP:
        return None
    counts = np.zeros(len(times))
    for first in (0, 1):
        counts[first + 2 :: 2] = np.cumsum(times[first + 1 : -1 : 2])
    middles = 0.5 * (counts[:-2:2] + counts[2::2])
    counts[1::2] += np.rint(np.median(middles - counts[1::2][: len(middles)]))
    since = np.diff(counts)
    begun = float(np.clip(2.0 * since[0] - since[1], min(0.0, since[0]), max(0.0, since[0])))
    return np.asarray(2.0 * step * np.concatenate(([begun], since)))


def around_the_row(speeds: FloatArray, step: float) -> bool:
    """Whether speeds (n) of such steps are from the row before to the next: else what they would be made of goes to and
    fro by ever more, as their errors add up.
    """
    since = since_the_row_before(speeds, step)
    if since is None:
        return False
    moving = speeds[1:-1] != 0.0
    if int(np.count_nonzero(moving)) < FEWEST:
        return False
    made_of, readings = (np.abs(np.diff(x, 2))[moving] for x in (since / (2.0 * step), speeds / step))
    return float(np.median(made_of)) <= ROUGHER * (float(np.median(readings)) + 2.0)
