"""The time column of a foreign table: its unit, its beginning, counters that begin anew, stamps too coarse for rows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fiohost.errors import DataError
from fiohost.importing.raw import TIME, FloatArray
from fiohost.importing.roles import Head

SHORTEST_S, LONGEST_S = 1e-5, 0.5  # between rows of a log of a motor
REPEATED = 0.2  # share of rows with the stamp of the row before, from which stamps are too coarse
EVEN = 0.35  # by how much the rows of a stamp may differ, as a share
COUNTERS = (2.0**16, 2.0**32)
DAY_S = 86_400.0
EPOCHS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3), (5e8, 1.0))  # since 1970: above this number it is in such units
EXCEL_DAYS = (20_000.0, 80_000.0)


@dataclass(frozen=True)
class Clock:
    """How rows get their times, ``tick_s`` apart; ``line`` and ``assumed`` say it in words."""

    column: str | None
    scale: float = 1.0
    wrap: float = 0.0
    sample_time_s: float = 0.0
    line: str = ""
    assumed: str = ""
    tick_s: float = 0.0


def clock_of(head: Head, path: Path) -> Clock:
    """Understand a column of time. Raises DataError where it runs backwards or stands still."""
    column, name = head.column, head.column.name
    values = column.values[np.isfinite(column.values)]
    if values.size < 2:
        raise DataError(f"{path}: the column of time {name!r} has fewer than two times")
    wrap = 0.0
    steps = np.diff(values)
    if np.any(steps < 0):
        wrap = next((size for size in COUNTERS if np.all(steps[steps < 0] < -0.5 * size) and values.max() < size), 0.0)
        if not wrap:
            row = int(np.argmax(steps < 0)) + 2
            raise DataError(
                f"{path}: the time {name!r} runs backwards at row {row} of the data: two runs in one table?"
            )
        steps = np.where(steps < 0, steps + wrap, steps)
    span = float(steps.sum())
    if span <= 0.0:
        raise DataError(f"{path}: the time {name!r} stands still")
    moving = steps[steps > 0]
    told, assumed = _scale(head, values, float(np.median(moving)))
    scale = told
    if float(np.mean(steps == 0)) > REPEATED:
        return _coarse(name, values, scale, path)
    tick_s = float(np.median(moving)) * scale
    kind = "dates or clock" if column.kind == TIME else _unit_words(scale)
    line = f"time: {name!r}, {kind}, rows {tick_s:.6g} s apart" + (f", begins anew at {wrap:.0f}" if wrap else "")
    return Clock(name, scale, wrap, line=line, assumed=assumed, tick_s=tick_s)


def _scale(head: Head, values: FloatArray, step: float) -> tuple[float, str]:
    """Seconds of one, and a sentence where that is likely and not told."""
    if head.column.kind == TIME:
        return 1.0, ""
    if head.unit is not None:
        return head.unit.scale, ""
    if head.words & {"millis", "ms"}:
        return 1e-3, ""
    if head.words & {"micros", "us"}:
        return 1e-6, ""
    name, first = head.column.name, float(values[0])
    for least, scale in EPOCHS:
        if first > least and step * scale < 1e4 * LONGEST_S and SHORTEST_S <= step * scale <= LONGEST_S:
            return scale, f"{name!r} is in {_unit_words(scale)} since 1970"
    if EXCEL_DAYS[0] < first < EXCEL_DAYS[1] and step * DAY_S < LONGEST_S and step < 1e-4:
        return DAY_S, f"{name!r} is in days, as a spreadsheet counts them"
    whole = bool(np.all(values == np.rint(values)))
    for scale in (1e-3, 1e-6, 1e-9, 1.0) if whole else (1.0, 1e-3, 1e-6):
        if SHORTEST_S <= step * scale <= LONGEST_S:
            return scale, f"{name!r} is in {_unit_words(scale)}"
    return 1.0, f"{name!r} is in seconds, though rows would be {step:g} s apart"


def _coarse(name: str, values: FloatArray, scale: float, path: Path) -> Clock:
    """Stamps that stay the same over several rows: rows are evenly spaced where all stamps have about as many."""
    changes = np.flatnonzero(np.diff(values) != 0) + 1
    counts = np.diff(changes)
    if len(counts) < 2 or float(np.std(counts)) > EVEN * float(np.mean(counts)):
        raise DataError(
            f"{path}: the time {name!r} is the same in several rows, and not in equally many: nobody can tell when "
            "they were measured; write it with more digits"
        )
    steps = np.diff(values[[changes[0], changes[-1]]])[0] * scale
    tick_s = float(f"{steps / (changes[-1] - changes[0]):.4g}")
    return Clock(
        None,
        sample_time_s=tick_s,
        line=f"time: {name!r} is too coarse for single rows",
        assumed=f"rows are evenly spaced, {tick_s:g} s apart: {np.mean(counts):.3g} of them share a time of {name!r}",
        tick_s=tick_s,
    )


def _unit_words(scale: float) -> str:
    words = {1.0: "seconds", 1e-3: "milliseconds", 1e-6: "microseconds", 1e-9: "nanoseconds", DAY_S: "days"}
    return words.get(scale, f"units of {scale:g} s")
