"""Speeds that were taken from counts of several rows, and the mean speeds since the row before that they are made of.

``gradient`` of numpy and MATLAB gives them from the row before to the next; a moving average over so many rows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.importing.raw import FloatArray, RawColumn

FEWEST = 50  # rows with motion, to tell by
OFF_STEP = 0.2  # share of a step by which a reading may be off one
ROUGHER = 1.5  # times as rough as the readings, and two of their steps, is what was never so made up: 4 to 60 times
MOST_ROWS = 10


def since_the_row_before(speeds: FloatArray, step: float, rows: int, ahead: int = 0) -> FloatArray | None:
    """Mean speeds since the row before (n) of a counter of which ``speeds`` (n) are the differences over ``rows`` rows,
    ``ahead`` of which come after the reading's; a ``step`` is one count in all of them. None where they are of no such
    steps.

    They tell every count from the one so many rows before. How far these series are apart is where neighbours agree.
    """
    times, n = np.rint(speeds / step), len(speeds)
    if n < max(FEWEST, 3 * rows) or float(np.quantile(np.abs(speeds / step - times), 0.99)) > OFF_STEP:
        return None
    counts = np.zeros(n)
    for first in range(rows):
        counts[first + rows :: rows] = np.cumsum(times[first + rows - ahead : n - ahead : rows])
    knots = counts[::rows].copy()
    for first in range(1, rows):
        own = counts[first::rows]
        between = knots[:-1] + np.diff(knots) * (first / rows)
        own += np.rint(np.median(between - own[: len(between)]))
    since = np.diff(counts)
    begun = float(np.clip(2.0 * since[0] - since[1], min(0.0, since[0]), max(0.0, since[0])))
    return np.asarray(rows * step * np.concatenate(([begun], since)))


def is_made_up(speeds: FloatArray, step: float, rows: int, ahead: int = 0) -> bool:
    """Whether speeds (n) are such differences: else what they would be made of goes to and fro by ever more, as their
    errors add up.
    """
    since = since_the_row_before(speeds, step, rows, ahead)
    moving = speeds[1:-1] != 0.0
    if since is None or int(np.count_nonzero(moving)) < FEWEST:
        return False
    made_of, readings = (np.abs(np.diff(x, 2))[moving] for x in (since / (rows * step), speeds / step))
    return float(np.median(made_of)) <= ROUGHER * (float(np.median(readings)) + 2.0)


def over_rows(columns: Sequence[RawColumn], step: float) -> tuple[int, int]:
    """Over how many rows a speed of such steps is a difference in all tables of a bench, and how many of these come
    after its own: since the row before (1, 0) where it is made up of no others.

    The most: what is a mean over eight rows is one of means over four.
    """
    speeds = [column.values[np.isfinite(column.values)] for column in columns]
    ways = [*((rows, 0) for rows in range(MOST_ROWS, 2, -1)), (2, 1)]
    return next((way for way in ways if all(is_made_up(s, step, *way) for s in speeds)), (1, 0))
