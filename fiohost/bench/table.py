"""Reading a foreign table of numbers: any CSV or TSV text with one header row, treated as hostile.

Size, line length and row count are bounded; only the columns asked for are turned into numbers. What cannot be
read is refused in one sentence with file and line; only an incomplete last line (a recorder that crashed) is
dropped, and said so.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fiohost import files
from fiohost.errors import LogError
from fiohost.settings import nearest

MAX_BYTES = 400_000_000
MAX_ROWS = 5_000_000
MAX_COLUMNS = 1_000
MAX_LINE = 100_000
DELIMITERS = (",", ";", "\t", "|", " ")


@dataclass(frozen=True)
class NumberTable:
    """The wanted columns of one file as float64 arrays of equal length, all finite."""

    path: Path
    columns: dict[str, NDArray[np.float64]]
    sha256: str
    dropped: tuple[str, ...]

    @property
    def rows(self) -> int:
        return len(next(iter(self.columns.values())))


def read_table(path: Path, wanted: Sequence[str]) -> NumberTable:
    """Read the columns named *wanted* (at least one) from the table at *path*.

    Lines starting with ``#`` and blank lines are skipped. The delimiter is the one under which the header row
    holds most of the wanted names. Where it is not the comma, a decimal comma is understood. Raises LogError.
    """
    text, digest = _read_text(path)
    lines = _data_lines(text, path)
    header_line = next(lines, None)
    if header_line is None:
        raise LogError(f"{path} is empty: a table needs a header row with column names and rows of numbers")
    delimiter, header = _header(header_line[1], wanted, path)
    places = [header.index(name) for name in wanted]
    values = [array("d") for _ in wanted]
    dropped: list[str] = []
    pending: tuple[int, list[str]] | None = None  # a short row: allowed only where nothing follows it
    for number, line in lines:
        if pending is not None:
            raise LogError(_short_row(path, pending, len(header)))
        cells = _split(line, delimiter, path, number)
        if len(cells) < len(header):
            pending = (number, cells)
            continue
        if any(cells[len(header) :]):
            raise LogError(f"{path} line {number}: {len(cells)} cells under {len(header)} column names")
        if len(values[0]) >= MAX_ROWS:
            raise LogError(f"{path} has more than {MAX_ROWS} rows: cut it into shorter records")
        for name, place, column in zip(wanted, places, values, strict=True):
            column.append(_number(cells[place], delimiter, f"{path} line {number}, column {name!r}"))
    if pending is not None:
        dropped.append(f"the last line ({pending[0]}), which is incomplete")
    if not values[0]:
        raise LogError(f"{path} has a header row but no row of numbers")
    columns = {name: np.array(column, dtype=np.float64) for name, column in zip(wanted, values, strict=True)}
    return NumberTable(path, columns, digest, tuple(dropped))


def read_cells(path: Path, most_rows: int) -> tuple[list[dict[str, str]], str]:
    """A small table as it stands: one mapping a row from column name to text, and the file's SHA-256. Raises LogError.

    For tables that people write, where a cell may be text or empty; a row that is cut short is refused.
    """
    text, digest = _read_text(path)
    lines = list(_data_lines(text, path))
    if len(lines) < 2:
        raise LogError(f"{path}: a table needs a header row with column names and at least one row below it")
    if len(lines) > most_rows + 1:
        raise LogError(f"{path} has more than {most_rows} rows, too many for a table of readings")
    delimiter, header = _header(lines[0][1], (), path)
    twice = next((name for name in header if header.count(name) > 1), None)
    if twice is not None:
        raise LogError(f"{path} has {header.count(twice)} columns named {twice[:60]!r}: rename all but one")
    rows = []
    for number, line in lines[1:]:
        cells = _split(line, delimiter, path, number)
        if len(cells) != len(header):
            raise LogError(f"{path} line {number}: {len(cells)} cells under {len(header)} column names")
        rows.append(dict(zip(header, cells, strict=True)))
    return rows, digest


def _read_text(path: Path) -> tuple[str, str]:
    data = files.read_input(path, MAX_BYTES, "the table", LogError)
    if b"\0" in data[:4096] or data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise LogError(f"{path} is not a text table in UTF-8: export it as CSV (UTF-8) first")
    return data.decode("utf-8-sig", errors="replace"), hashlib.sha256(data).hexdigest()


def _data_lines(text: str, path: Path) -> Iterator[tuple[int, str]]:
    for number, line in enumerate(io.StringIO(text), start=1):
        if len(line) > MAX_LINE:
            raise LogError(f"{path} line {number} is longer than {MAX_LINE} characters: this is not a table of numbers")
        stripped = line.strip(" \r\n")
        if stripped and not stripped.startswith("#"):
            yield number, stripped


def _split(line: str, delimiter: str, path: Path, number: int) -> list[str]:
    if delimiter == " ":
        return line.split()
    try:
        cells = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True, strict=True))
    except csv.Error as exc:
        raise LogError(f"{path} line {number} cannot be split into cells: {exc}") from exc
    return [cell.strip() for cell in cells]


def _header(line: str, wanted: Sequence[str], path: Path) -> tuple[str, list[str]]:
    best: tuple[int, int] = (-1, 0)
    delimiter, header = ",", [line]
    for candidate in DELIMITERS:
        try:
            cells = _split(line, candidate, path, 1)
        except LogError:
            continue
        rank = (sum(name in cells for name in wanted), len(cells))
        if rank > best:
            best, delimiter, header = rank, candidate, cells
    if len(header) > MAX_COLUMNS:
        raise LogError(f"{path} has {len(header)} columns, more than {MAX_COLUMNS}")
    if all(_is_number(cell) for cell in header if cell):
        raise LogError(f"{path} starts with a row of numbers: put a header row with column names above it")
    for name in wanted:
        if header.count(name) > 1:
            raise LogError(f"{path} has {header.count(name)} columns named {name!r}: rename all but one")
        if name not in header:
            raise LogError(f"{path} has no column {name!r}; {nearest(name, [c[:60] for c in header[:20] if c])}")
    return delimiter, header


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _number(cell: str, delimiter: str, where: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        try:
            value = float(cell.replace(",", ".", 1) if delimiter != "," else "")
        except ValueError:
            what = "an empty cell" if not cell else f"{cell[:40]!r}"
            raise LogError(f"{where}: {what} is not a number; a missing sample must be a missing row") from None
    if not math.isfinite(value):
        raise LogError(f"{where}: {cell[:40]!r} is not a finite number; a missing sample must be a missing row")
    return value


def _short_row(path: Path, row: tuple[int, list[str]], width: int) -> str:
    return f"{path} line {row[0]}: {len(row[1])} cells under {width} column names"
