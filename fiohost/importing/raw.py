"""A foreign table as it was read: named columns, the units written with them, and what was left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fiohost.errors import LogError
from fiohost.settings import nearest

FloatArray = NDArray[np.float64]

NUMBER, TIME, TEXT = "number", "time", "text"
MAX_BYTES = 400_000_000
MAX_ROWS = 5_000_000
MAX_COLUMNS = 1_000
MAX_CELLS = 30_000_000
MAX_NUMBER = 1e30  # times in nanoseconds have 1e18; what recorders write for "no value" begins here


@dataclass(frozen=True)
class RawColumn:
    """One column, shape (rows,): numbers, NaN where a cell is missing; of TIME seconds from the first, of TEXT all NaN.

    ``unit`` is the text of the unit as it stands in the table, "" where there is none. ``bad`` is the first cell that
    is neither a number nor missing, and its line. Of TEXT with few different cells these are its ``words``, and
    ``values`` are their places among them.
    """

    name: str
    values: FloatArray
    unit: str = ""
    kind: str = NUMBER
    bad: tuple[int, str] | None = None
    missing: tuple[int, str] | None = None  # the first missing cell and its line
    begins: str = ""  # of times with a date: the first, as ISO 8601
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class RawTable:
    """Columns of one length. ``form`` says in words how the file is written, ``notes`` what was left out of it."""

    path: Path
    sha256: str
    columns: tuple[RawColumn, ...]
    form: str
    titles: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    named: bool = True  # whether the table has names for its columns

    @property
    def rows(self) -> int:
        return len(self.columns[0].values) if self.columns else 0

    @property
    def names(self) -> list[str]:
        return [column.name for column in self.columns]

    def column(self, name: str) -> RawColumn:
        """The column of that name. Raises LogError naming the nearest."""
        for column in self.columns:
            if column.name == name:
                return column
        raise LogError(f"{self.path} has no column {name!r}; {nearest(name, [n[:60] for n in self.names[:20] if n])}")


def within_reason(values: FloatArray) -> FloatArray:
    """The same numbers, shape (rows,), infinite where they are too large for a measurement."""
    return np.where(np.abs(values) >= MAX_NUMBER, np.copysign(np.inf, values), values)


def checked_size(path: Path, rows: int, columns: int) -> None:
    """Refuse what is beyond all measure. Raises LogError."""
    if columns > MAX_COLUMNS:
        raise LogError(f"{path} has {columns} columns, more than {MAX_COLUMNS}")
    if rows > MAX_ROWS:
        raise LogError(f"{path} has more than {MAX_ROWS} rows: cut it into shorter records")
    if rows * columns > MAX_CELLS:
        raise LogError(f"{path} has {rows} rows of {columns} columns: keep the columns that are needed, or cut it")


def unique_names(names: Sequence[str]) -> list[str]:
    """Names that differ: the second of a name gets `` (2)``; a nameless column is ``column N``."""
    found: list[str] = []
    for number, name in enumerate(names, start=1):
        base = name or f"column {number}"
        unique, count = base, 2
        while unique in found:
            unique, count = f"{base} ({count})", count + 1
        found.append(unique)
    return found
