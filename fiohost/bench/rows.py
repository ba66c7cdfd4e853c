"""The rows of a log as numbers: fast where the text is clean, careful where it is not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fiohost.errors import LogError

MAX_COLUMNS = 200
MAX_BAD_SHARE = 0.1  # of all lines: a file with more broken lines than this is not a log
MAX_NAMED_COLUMNS = 3


@dataclass(frozen=True)
class Rows:
    """Columns of equal length (NaN where a field is empty) and sentences about lines and columns left out."""

    columns: dict[str, NDArray[np.float64]]
    notes: tuple[str, ...]


def parse_rows(text: str, names: list[str], needed: list[str], first_line: int, where: str) -> Rows:
    """Read the lines after the header.

    Lines with too few or too many fields, or with text in one of the *needed* columns, are left out; other columns
    that hold text are left out whole. Raises LogError where a tenth of the lines or more are broken.
    """
    if len(names) > MAX_COLUMNS:
        raise LogError(f"{where} is not a log: {len(names)} columns, at most {MAX_COLUMNS} are read")
    for empty, filled in ((",,", ",nan,"), (",,", ",nan,"), (",\n", ",nan\n"), ("\n,", "\nnan,")):
        text = text.replace(empty, filled)
    if text.startswith(","):
        text = "nan" + text
    lines = text.split("\n")
    commas = len(names) - 1
    fits = [line.count(",") == commas and line[:1] != "#" for line in lines]
    if len(names) == 1:
        fits = [ok and bool(line.strip()) for ok, line in zip(fits, lines, strict=True)]
    bad = [i for i, ok in enumerate(fits) if not ok and lines[i].strip() and lines[i][0] != "#"]
    good = [i for i, ok in enumerate(fits) if ok] if bad else []
    rows = [line for line, ok in zip(lines, fits, strict=True) if ok]

    notes: list[str] = []
    columns = _fast(rows, names)
    if columns is None:
        columns, broken, textual = _careful(rows, names, needed)
        if broken.any():
            numbers = good or [i for i, ok in enumerate(fits) if ok]
            bad += [numbers[i] for i in np.flatnonzero(broken)]
            columns = {name: values[~broken] for name, values in columns.items()}
        if textual:
            shown = ", ".join(textual[:MAX_NAMED_COLUMNS])[:120]
            notes.append(f"{len(textual)} columns that hold text ({shown})")
    if bad:
        if len(bad) > MAX_BAD_SHARE * (len(rows) + len(bad)) and len(bad) > 1:
            raise LogError(
                f"{where}: {len(bad)} of {len(rows) + len(bad)} lines do not fit the {len(names)} columns "
                f"(the first is line {first_line + min(bad)}): this is not a log, or badly damaged"
            )
        notes.append(f"{len(bad)} lines that do not fit the columns (the first is line {first_line + min(bad)})")
    return Rows(columns, tuple(notes))


def _fast(rows: list[str], names: list[str]) -> dict[str, NDArray[np.float64]] | None:
    """All columns at once; None where a field is not a number."""
    if not rows:
        return {name: np.zeros(0) for name in names}
    try:
        table = np.loadtxt(rows, delimiter=",", comments=None, dtype=np.float64, ndmin=2)
    except ValueError:
        return None
    if table.shape != (len(rows), len(names)):
        return None
    return {name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(names)}


def _careful(
    rows: list[str], names: list[str], needed: list[str]
) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.bool_], list[str]]:
    """Column by column: the numbers, which rows have text in a needed column, and which columns are text."""
    fields = list(zip(*(row.split(",") for row in rows), strict=True))
    broken = np.zeros(len(rows), dtype=np.bool_)
    columns: dict[str, NDArray[np.float64]] = {}
    textual: list[str] = []
    for name, values in zip(names, fields, strict=True):
        try:
            columns[name] = np.array(values).astype(np.float64)
        except ValueError:
            if name not in needed:
                textual.append(name)
                continue
            numbers = [_number(value) for value in values]
            broken |= np.array([number is None for number in numbers])
            columns[name] = np.array([np.nan if number is None else number for number in numbers])
    return columns, broken, textual


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
