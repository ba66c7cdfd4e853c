"""Tables of text, treated as hostile: encoding, delimiter, decimal mark, title rows, names, units and rows are found.

Size, line length and row count are bounded. An incomplete last line (a recorder that crashed) and lines of text at the
end are dropped, and that is said; a short or long row within the data is refused with its line.
"""

from __future__ import annotations

import codecs
import csv
import hashlib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fiohost import files
from fiohost.errors import LogError
from fiohost.importing.cells import column_of, is_comma_number, is_missing, is_point_number, is_time, is_value
from fiohost.importing.raw import MAX_BYTES, NUMBER, RawColumn, RawTable, checked_size, unique_names
from fiohost.importing.units import is_unit
from fiohost.settings import counted

MAX_LINE = 100_000
DELIMITERS = (",", ";", "\t", "|", " ")
DELIMITER_WORDS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "blanks"}
SAMPLE = 400  # lines that decide how a table is written
MOST_FOOTERS = 20  # lines of text below the data
HEADER_SOON = 30  # lines of a title block that look like data
COMMENTS = ("#", "%", "//")
_NOTHING = np.zeros(0)


@dataclass(frozen=True)
class _Line:
    number: int
    text: str
    comment: bool


@dataclass(frozen=True)
class _Dialect:
    delimiter: str
    width: int  # cells of a row
    start: int  # index of the first row of data among the lines that are no comments


def read_text_table(path: Path, wanted: Sequence[str] = ()) -> RawTable:
    """Read the table at *path*; of columns, where *wanted* are named, only those become numbers. Raises LogError."""
    data = files.read_input(path, MAX_BYTES, "the table", LogError)
    text, encoding = decoded(data, path)
    lines = _lines(text, path)
    body = [line for line in lines if not line.comment]
    if not body:
        raise LogError(f"{path} is empty: a table needs a header row with column names and rows of numbers")
    dialect = _dialect(body, path)
    names, units, titles = _head(lines, body, dialect)
    if wanted and not names:
        raise LogError(f"{path} starts with a row of numbers: put a header row with column names above it")
    for name in wanted:
        if names.count(name) > 1:
            raise LogError(f"{path} has {names.count(name)} columns named {name!r}: rename all but one")
    shown = unique_names(names or [""] * dialect.width)
    heads = {line.text for line in body[: dialect.start]}
    data_lines = [line for line in body[dialect.start :] if line.text not in heads]
    again = len(body) - dialect.start - len(data_lines)
    rows, numbers, notes = _rows(data_lines, dialect, path)
    notes += [f"{counted(again, 'line')} with the names again"] if again else []
    checked_size(path, len(rows), len(wanted) or dialect.width)
    comma = _comma(rows, dialect)
    if names and 2 * len(names) == dialect.width and dialect.delimiter == ",":
        raise LogError(
            f"{path}: {dialect.width} cells under {len(names)} column names: decimal commas between commas cannot be "
            "told apart; export it with semicolons, or with decimal points"
        )
    columns = []
    for place, name in enumerate(shown[: dialect.width]):
        if wanted and name not in wanted:
            columns.append(RawColumn(name, _NOTHING, units[place], NUMBER))
            continue
        cells = [row[place] for row in rows]
        columns.append(column_of(name, units[place], cells, comma, numbers))
    form = [f"{DELIMITER_WORDS[dialect.delimiter]} between cells"]
    form += ["decimal commas"] if comma else []
    form += [encoding] if encoding != "UTF-8" else []
    form += [counted(len(titles), "title row")] if titles else []
    form += ["units in a row of their own"] if any(units) else []
    return RawTable(
        path,
        hashlib.sha256(data).hexdigest(),
        tuple(columns),
        ", ".join(form),
        tuple(titles),
        tuple(notes),
        bool(names),
    )


def decoded(data: bytes, path: Path) -> tuple[str, str]:
    """The text of a file, and its encoding: a byte order mark, zero bytes in every second place, or valid UTF-8 decide;
    else it is Windows' own. Raises LogError.
    """
    for mark, name, codec in (
        (codecs.BOM_UTF8, "UTF-8", "utf-8-sig"),
        (codecs.BOM_UTF16_LE, "UTF-16", "utf-16"),
        (codecs.BOM_UTF16_BE, "UTF-16", "utf-16"),
    ):
        if data.startswith(mark):
            return data.decode(codec, errors="replace"), name
    head = data[:4096]
    if b"\0" in head:
        for codec, odd in (("utf-16-le", 1), ("utf-16-be", 0)):
            zeros = head[odd::2].count(0)
            if zeros > 0.9 * len(head[odd::2]):
                text = data.decode(codec, errors="replace")
                if "\n" in text or "\r" in text:
                    return text, "UTF-16"
        raise LogError(f"{path} is not a text table, and not a log: it holds zero bytes; export it as CSV first")
    try:
        return data.decode("utf-8"), "UTF-8"
    except UnicodeDecodeError as exc:
        if exc.start >= len(data) - 3:  # cut off inside a character
            return data[: exc.start].decode("utf-8"), "UTF-8"
    return data.decode("cp1252", errors="replace"), "Windows-1252"


def _lines(text: str, path: Path) -> list[_Line]:
    found = []
    for count, line in enumerate(re.split(r"\r\n|\n|\r", text.replace("\0", " ")), start=1):
        if len(line) > MAX_LINE:
            raise LogError(f"{path} line {count} is longer than {MAX_LINE} characters: this is not a table of numbers")
        stripped = line.strip(" ")
        if stripped.strip():
            found.append(_Line(count, stripped, stripped.startswith(COMMENTS)))
    return found


def split(line: str, delimiter: str) -> list[str]:
    """The cells of one line. A date and a clock with a blank between are one cell."""
    if delimiter == " ":
        cells = line.split()
        joined: list[str] = []
        for cell in cells:
            if joined and is_time(f"{joined[-1]} {cell}") and not is_time(joined[-1]):
                joined[-1] += f" {cell}"
            else:
                joined.append(cell)
        return joined
    if '"' in line or "'" in line:
        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]
        except (csv.Error, StopIteration):
            return [line]
    return [cell.strip() for cell in line.split(delimiter)]


def _is_data(cells: Sequence[str]) -> bool:
    """Whether a line looks like a row of data: a number or a time in it, and half of its cells values."""
    values = sum(is_value(cell) for cell in cells)
    filled = sum(is_value(cell) and not is_missing(cell) for cell in cells)
    return filled > 0 and 2 * values >= len(cells)


def _is_head(cells: Sequence[str]) -> bool:
    """Whether a line looks like a row of names or units: text, and no number or time."""
    filled = [cell for cell in cells if cell]
    return bool(filled) and not any(is_value(cell) and not is_missing(cell) for cell in filled)


def _dialect(body: Sequence[_Line], path: Path) -> _Dialect:
    sample = body[:SAMPLE]
    best: tuple[float, int, _Dialect] | None = None
    for delimiter in DELIMITERS:
        split_lines = [split(line.text, delimiter) for line in sample]
        split_lines = _trimmed(split_lines)
        widths = Counter(len(cells) for cells in split_lines if _is_data(cells))
        if not widths:
            continue
        width = max(widths, key=lambda w: (widths[w], w))
        start = _start(split_lines, width)
        sound = [cells for cells in split_lines[start:] if len(cells) == width and _is_data(cells)]
        values = sum(sum(map(is_value, cells)) for cells in sound) / max(1, sum(map(len, sound)))
        named = any(len(cells) == width and _is_head(cells) for cells in split_lines[:start])
        rank = len(sound) * values + (0.5 if named else 0.0)
        if best is None or (rank, width) > best[:2]:
            best = rank, width, _Dialect(delimiter, width, start)
    if best is None:
        if any(any(char.isdigit() for char in line.text) for line in body):
            raise LogError(f"{path} is no table of numbers that can be told: no delimiter makes rows of equal length")
        raise LogError(f"{path} has a header row but no row of numbers")
    return best[2]


def _trimmed(split_lines: list[list[str]]) -> list[list[str]]:
    """Without the empty cells that a delimiter at the end of each line makes; a column that one line fills, as remarks
    are, stays.
    """
    widths = Counter(len(cells) for cells in split_lines if len(cells) > 1)
    if not widths:
        return split_lines
    full = max(widths, key=lambda width: (widths[width], width))
    if any(cells[-1] for cells in split_lines if len(cells) == full):
        return split_lines
    return [cells[:-1] if len(cells) > 1 and not cells[-1] else cells for cells in split_lines]


def _start(split_lines: Sequence[Sequence[str]], width: int) -> int:
    """Index of the first row of data: below the last row of names of a title block."""
    rows = [len(cells) == width and _is_data(cells) for cells in split_lines]
    start = rows.index(True)
    while True:
        later = [
            i
            for i in range(start + 1, min(start + HEADER_SOON, len(split_lines)))
            if len(split_lines[i]) >= width and _is_head(split_lines[i])
        ]
        after = [i for i in range(later[-1] + 1, len(rows)) if rows[i]] if later else []
        if not later or len(after) <= sum(rows[start : later[-1]]):
            return start
        start = after[0]


def _head(lines: Sequence[_Line], body: Sequence[_Line], dialect: _Dialect) -> tuple[list[str], list[str], list[str]]:
    """Names (none where the table has none), units in a row of their own, and the lines of titles and comments."""
    width = dialect.width
    above = list(body[: dialect.start])
    comments = [line for line in lines if line.comment and line.number < body[dialect.start].number]
    heads: list[tuple[_Line, list[str]]] = []
    for line in reversed(above[-3:]):
        cells = _named(line.text, dialect.delimiter, width)
        if cells is None or not _is_head(cells):
            break
        heads.append((line, cells))
    if not heads and comments:
        for line in reversed(comments[-2:]):
            cells = _named(line.text.lstrip("#%/ "), dialect.delimiter, width)
            if cells is not None and _is_head(cells):
                heads.append((line, cells))
                break
    names: list[str] = []
    units = [""] * width
    used: list[_Line] = []
    if heads:
        at = 0
        if len(heads) > 1 and _are_units(heads[0][1]) and not _are_units(heads[1][1]):
            units = [cell.strip("[](){}<> ") for cell in heads[0][1]]
            used.append(heads[0][0])
            at = 1
        names = heads[at][1][:width]
        used.append(heads[at][0])
    titles = [line.text[:300] for line in lines if line.number < body[dialect.start].number and line not in used]
    units = (units + [""] * width)[:width]
    return names, units, [title for title in titles if not re.match(r"sep\s*=", title, re.IGNORECASE)]


def _named(line: str, delimiter: str, width: int) -> list[str] | None:
    """The cells of a row of names for so many columns, whatever separates them; None where they do not fit."""
    for candidate in (delimiter, *DELIMITERS):
        cells = split(line, candidate)
        if len(cells) >= width and not any(cells[width + 1 :]):
            return cells[:width]
    if delimiter == " ":
        cells = re.split(r"\s{2,}", line.strip())
        if len(cells) == width:
            return cells
        cells = re.split(r"\s+(?![\[(])", line.strip())
        if len(cells) == width:
            return cells
    cells = split(line, delimiter)
    return cells if len(cells) > 1 and width == 2 * len(cells) and delimiter == "," else None


def _are_units(cells: Sequence[str]) -> bool:
    filled = [cell for cell in cells if cell.strip("[](){}<>- ")]
    known = sum(is_unit(cell.strip("[](){}<> ")) or cell[:1] in "[(" for cell in filled)
    return not filled or 2 * known > len(filled)


def _rows(body: Sequence[_Line], dialect: _Dialect, path: Path) -> tuple[list[list[str]], list[int], list[str]]:
    """Cells of every row of data, the lines they are on, and what was left out."""
    width, delimiter = dialect.width, dialect.delimiter
    rows: list[list[str]] = []
    numbers: list[int] = []
    notes: list[str] = []
    end = len(body)
    while end > 1 and len(body) - end < MOST_FOOTERS and _is_footer(body[end - 1].text, delimiter, width):
        end -= 1
    if end < len(body):
        short = len(body) - end == 1 and any(map(is_value, split(body[-1].text, delimiter)[:1]))
        what = "which is incomplete" if short else "which are no data"
        left = f"the last line ({body[-1].number})" if len(body) - end == 1 else f"the last {len(body) - end} lines"
        notes.append(f"{left}, {'which is no data' if what.startswith('which are') and len(body) - end == 1 else what}")
    for line in body[:end]:
        cells = split(line.text, delimiter)
        if len(cells) < width or any(cells[width:]):
            raise LogError(f"{path} line {line.number}: {len(cells)} cells under {width} column names")
        rows.append(cells)
        numbers.append(line.number)
    if not rows:
        raise LogError(f"{path} has a header row but no row of numbers")
    return rows, numbers, notes


def _is_footer(line: str, delimiter: str, width: int) -> bool:
    cells = split(line, delimiter)
    return len(cells) < width or not _is_data(cells[:width])


def _comma(rows: Sequence[Sequence[str]], dialect: _Dialect) -> bool:
    """Whether a comma is the decimal mark."""
    commas = points = 0
    for row in (*rows[:2000], *rows[-200:]):
        for cell in row:
            if "," in cell and not is_time(cell) and is_comma_number(cell):
                commas += 1
            elif "." in cell and is_point_number(cell):
                points += 1
    if dialect.delimiter == "," and commas and points:
        return commas > points
    return commas > 0
