"""The rows of a log as numbers: fast where the text is clean, careful where it is not.

Large clean pieces are read by pyarrow where it is installed, other clean ones by numpy; what either refuses is read
field by field. All three read a number as the double next to it, so it does not matter which did.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fiohost.bench.integrity import line_ends
from fiohost.errors import LogError

MAX_COLUMNS = 200
MAX_BAD_SHARE = 0.1  # of all lines: a file with more broken lines than this is not a log
MAX_NAMED_COLUMNS = 3
PIECE_BYTES = 4_000_000  # that are read at a time: what is in between takes little memory
LARGE_BYTES = 1_000_000  # from here on pyarrow is worth its import

Parts = dict[str, list[NDArray[np.float64]]]  # by column, one array after the other


@dataclass(frozen=True)
class Rows:
    """Columns of equal length (NaN where a field is empty) and sentences about lines and columns left out."""

    columns: dict[str, NDArray[np.float64]]
    notes: tuple[str, ...]


def parse_rows(
    data: bytes, start: int, end: int, names: list[str], needed: list[str], first_line: int, where: str
) -> Rows:
    """Read the lines after the header, *start* to *end* of a file's bytes; *first_line* is the number of their first.

    Lines with too few or too many fields, or with text in one of the *needed* columns, are left out; other columns
    that hold text are left out whole. Raises LogError where a tenth of the lines or more are broken.
    """
    if len(names) > MAX_COLUMNS:
        raise LogError(f"{where} is not a log: {len(names)} columns, at most {MAX_COLUMNS} are read")
    columns = dict(zip(names, np.empty((len(names), line_ends(data, start, end))), strict=True))
    textual: dict[str, None] = {}
    bad = rows = kept = 0
    first_bad: int | None = None
    begin = start
    while start < end:
        stop = min(after_line(data, start + PIECE_BYTES), end)
        try:
            found = _parse_piece(data, start, stop, names, needed)
        except UnicodeDecodeError as exc:
            raise LogError(f"{where} is not a log: byte {start + exc.start} is not UTF-8 text") from exc
        if found.bad and first_bad is None:
            first_bad = first_line + line_ends(data, begin, start) + found.bad[0]
        start, bad, rows = stop, bad + len(found.bad), rows + found.rows
        textual |= dict.fromkeys(found.textual)
        columns = {name: values for name, values in columns.items() if name in found.columns}
        before, kept = kept, kept + sum(map(len, next(iter(found.columns.values()))))
        for name, values in columns.items():
            np.concatenate(found.columns[name], out=values[before:kept])
    if bad > max(1.0, MAX_BAD_SHARE * (rows + bad)):
        raise LogError(
            f"{where}: {bad} of {rows + bad} lines do not fit the {len(names)} columns "
            f"(the first is line {first_bad}): this is not a log, or badly damaged"
        )
    notes: list[str] = []
    if textual:
        shown = ", ".join(list(textual)[:MAX_NAMED_COLUMNS])[:120]
        notes.append(f"{len(textual)} columns that hold text ({shown})")
    if bad:
        notes.append(f"{bad} lines that do not fit the columns (the first is line {first_bad})")
    return Rows({name: values[:kept] for name, values in columns.items()}, tuple(notes))


@dataclass(frozen=True)
class _Piece:
    """Whole rows of some lines; the lines that are none, counted from the first; columns that hold text."""

    columns: Parts
    rows: int
    bad: list[int]
    textual: list[str]


def after_line(data: bytes, at: int) -> int:
    """Where the line ends in which that byte is."""
    found = data.find(b"\n", at)
    return len(data) if found < 0 else found + 1


def _parse_piece(data: bytes, start: int, end: int, names: list[str], needed: list[str]) -> _Piece:
    found = _large(data, start, end, names) if end - start >= LARGE_BYTES else None
    if found is not None:
        return found
    text = data[start:end].decode()
    for empty, nan in ((",,", ",nan,"), (",,", ",nan,"), (",\n", ",nan\n"), ("\n,", "\nnan,")):
        text = text.replace(empty, nan)
    if text.startswith(","):
        text = "nan" + text
    lines = text.split("\n")
    if "#" not in text:
        filled = [line for line in lines if line]
        columns = _fast(filled, names)  # None where a line does not fit
        if columns is not None:
            return _Piece(columns, len(filled), [], [])
    commas = len(names) - 1
    fits = [line.count(",") == commas and line[:1] != "#" for line in lines]
    if len(names) == 1:
        fits = [ok and bool(line.strip()) for ok, line in zip(fits, lines, strict=True)]
    bad = [i for i, ok in enumerate(fits) if not ok and lines[i].strip() and lines[i][0] != "#"]
    rows = [line for line, ok in zip(lines, fits, strict=True) if ok]
    columns = _fast(rows, names)
    if columns is not None:
        return _Piece(columns, len(rows), bad, [])
    columns, broken, textual = _careful(rows, names, needed)
    if broken.any():
        numbers = [i for i, ok in enumerate(fits) if ok]
        bad = sorted(bad + [numbers[i] for i in np.flatnonzero(broken)])
        columns = {name: [part[~broken] for part in parts] for name, parts in columns.items()}
    return _Piece(columns, len(rows), bad, textual)


def _large(data: bytes, start: int, end: int, names: list[str]) -> _Piece | None:
    """A piece of clean rows by pyarrow; None without it, or where a line is anything else.

    The last line may be a remark, as every log ends with one.
    """
    try:
        from pyarrow import ArrowException, BufferReader, csv, float64
    except ImportError:
        return None
    last = max(start, data.rfind(b"\n", start, end - 1) + 1)
    stop = last if data.startswith(b"#", last, end) else end
    if data.find(b"\r", start, end) >= 0 or not data.endswith(b"\n", start, end) or not data[stop:end].isascii():
        return None  # what ends a line is not the same to both
    try:
        table = csv.read_csv(
            BufferReader(memoryview(data)[start:stop]),
            csv.ReadOptions(column_names=names),
            csv.ParseOptions(quote_char=False, double_quote=False),
            csv.ConvertOptions(column_types=dict.fromkeys(names, float64()), null_values=[""]),
        )
    except ArrowException:
        return None
    parts = {name: table.column(name).chunks for name in names}
    columns = {name: [part.to_numpy(zero_copy_only=False) for part in parts[name]] for name in names}  # empty is NaN
    return _Piece(columns, table.num_rows, [], [])


def _fast(rows: list[str], names: list[str]) -> Parts | None:
    """All columns at once; None where a field is not a number."""
    if not rows:
        return {name: [np.zeros(0)] for name in names}
    try:
        table = np.loadtxt(rows, delimiter=",", comments=None, dtype=np.float64, ndmin=2)
    except ValueError:
        return None
    if table.shape != (len(rows), len(names)):
        return None
    return {name: [table[:, i]] for i, name in enumerate(names)}


def _careful(rows: list[str], names: list[str], needed: list[str]) -> tuple[Parts, NDArray[np.bool_], list[str]]:
    """Column by column: the numbers, which rows have text in a needed column, and which columns are text."""
    fields = list(zip(*(row.split(",") for row in rows), strict=True))
    broken = np.zeros(len(rows), dtype=np.bool_)
    columns: Parts = {}
    textual: list[str] = []
    for name, values in zip(names, fields, strict=True):
        try:
            columns[name] = [np.array(values).astype(np.float64)]
        except ValueError:
            if name not in needed:
                textual.append(name)
                continue
            numbers = [_number(value) for value in values]
            broken |= np.array([number is None for number in numbers])
            columns[name] = [np.array([np.nan if number is None else number for number in numbers])]
    return columns, broken, textual


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
