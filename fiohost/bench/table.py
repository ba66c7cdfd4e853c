"""Small tables that people write, with one header row, treated as hostile: cells as they stand.

Size and line length are bounded; what cannot be read is refused in one sentence with file and line.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterator, Sequence
from pathlib import Path

from fiohost import files
from fiohost.errors import LogError
from fiohost.settings import nearest

MAX_BYTES = 400_000_000
MAX_COLUMNS = 1_000
MAX_LINE = 100_000
DELIMITERS = (",", ";", "\t", "|", " ")


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
