"""Times of a table in seconds: units, counters that begin anew, stamps of dates; and the tick they lie on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fiohost.errors import DataError
from fiohost.importing.raw import FloatArray

if TYPE_CHECKING:
    from fiohost.importing.map import TableMap

SHORTEST_S, LONGEST_S = 1e-7, 3600.0  # between rows: as of a map's sample_time_s
LONG_AGO_S = 1e5  # times that begin later count from something else than the run: the first row becomes 0


def times_s(values: FloatArray, table_map: TableMap, path: Path) -> tuple[FloatArray, list[str]]:
    """Seconds of each row, never running backwards, and notes. Raises DataError."""
    notes: list[str] = []
    if table_map.time_wrap:
        steps = np.diff(values, prepend=values[:1])
        values = values + table_map.time_wrap * np.cumsum(steps < -0.5 * table_map.time_wrap)
    if abs(values[0] * table_map.time_scale) > LONG_AGO_S:
        values = values - values[0]
    times = values * table_map.time_scale
    if len(times) < 2:
        raise DataError(f"{path} has one row: at least two are needed to know the sample time")
    steps = np.diff(times)
    if np.any(steps < 0) or not np.any(steps > 0):
        row = int(np.argmin(steps > 0)) + 2 if not np.any(steps < 0) else int(np.argmax(steps < 0)) + 2
        raise DataError(
            f"{path}: time does not increase at row {row} of the data ({table_map.time_column} = "
            f"{values[row - 1]:g}); sort the table or split it into records"
        )
    return times, notes


def spaced(time_s: FloatArray, path: Path) -> tuple[float, str]:
    """The sample time (s), and a note where times jitter. Raises DataError."""
    if len(time_s) < 2:
        raise DataError(f"{path} has one row: at least two are needed to know the sample time")
    tick_s = sample_time(time_s)
    if not SHORTEST_S <= tick_s <= LONGEST_S:
        raise DataError(
            f"{path}: rows are {tick_s:g} s apart, and a record of a motor has {SHORTEST_S:g} to {LONGEST_S:g} s: "
            "is the unit of time right?"
        )
    steps = np.diff(time_s) / tick_s
    jitter = float(np.abs(steps - np.rint(steps)).max())
    return tick_s, f"sample times jitter by up to {100 * jitter:.0f} % of a tick" if jitter > 0.1 else ""


def sample_time(time_s: FloatArray) -> float:
    """The tick of times that may be printed with few digits and miss rows: a straight line through time over tick.

    Ticks are counted with the median step at first and recounted as the line is known over twice as many rows; where
    the times do not lie on such a grid (no common tick) the mean or median step is the answer.
    """
    elapsed = time_s - time_s[0]
    median = float(np.median(np.diff(time_s)))
    step = median
    rows = 4
    while True:
        known = elapsed[:rows]
        ticks = np.rint(known / step)
        step = float(np.dot(known, ticks) / np.dot(ticks, ticks)) if ticks.any() else median
        if rows >= len(elapsed):
            break
        rows *= 2
    ticks = np.rint(elapsed / step)
    on_grid = float(np.std(elapsed / step - ticks)) < 0.2 and float(np.mean(np.diff(ticks) >= 1)) > 0.98
    if not on_grid:
        mean = float(elapsed[-1] / (len(elapsed) - 1))
        step = mean if abs(mean / median - 1.0) < 0.05 else median  # the mean, unless rows are missing
    return float(f"{step:.9g}")
