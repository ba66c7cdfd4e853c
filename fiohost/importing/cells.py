"""Cells of text as numbers, as times in seconds, or as missing."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta

import numpy as np

from fiohost.importing.raw import MAX_NUMBER, NUMBER, TEXT, TIME, FloatArray, RawColumn, within_reason

MISSING = frozenset(
    {"", "nan", "-", "--", "n/a", "na", "#n/a", "#nv", "null", "none", "?", "-nan", "1.#qnan", "missing"}
)
MOSTLY = 0.9  # share of a column's cells that make it one of numbers, the rest being wrong cells
DAY_S = 86_400.0
LOOKED_AT = 200  # cells that tell whether a column is one of times
FEW_WORDS = 8  # different cells of a column of text that are kept
LONGEST = 80  # characters of a number with its unit; the patterns take long over a long cell that nearly fits

_PLAIN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")
_COMMA = re.compile(r"[+-]?(\d{1,3}(\.\d{3})+,\d+|\d+,\d*|,\d+)([eE][+-]?\d+)?$")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(,\d{3})+(\.\d*)?$")
_WITH_UNIT = re.compile(r"([+-]?[\d.,]*\d[\d.,]*(?:[eE][+-]?\d+)?)\s*([A-Za-z%°µμ][^\s\d]{0,8}(?:\s?/\s?[a-z]{1,4})?)$")
_CLOCK = r"(\d{1,3}):(\d{2}):(\d{2})(?:[.,:](\d{1,9}))?\s*([AaPp][Mm])?"
_STAMP = re.compile(
    rf"(?:(\d{{4}})[-/.](\d{{1,2}})[-/.](\d{{1,2}})|(\d{{1,2}})([./-])(\d{{1,2}})[./-](\d{{4}}|\d{{2}}))[T ,]+{_CLOCK}"
    r"\s*(Z|UTC|[+-]\d{2}:?\d{2})?$"
)
_ONLY_CLOCK = re.compile(rf"{_CLOCK}$")
_MINUTES = re.compile(r"(\d{1,4}):(\d{2})[.,](\d{1,9})$")


def clean(cell: str) -> str:
    """A cell without the marks of typesetting: minus signs, thin spaces, apostrophes between thousands."""
    if cell.isascii() and "'" not in cell:
        return cell
    return cell.replace("\u2212", "-").translate(dict.fromkeys(map(ord, "\u00a0\u202f\u2009'\u2019")))


def is_missing(cell: str) -> bool:
    return cell.lower() in MISSING


def number(cell: str, comma: bool) -> float | None:
    """The number in a cell, ``comma`` being whether a comma is a decimal mark; None where it is no number.

    A unit behind the number is passed over, ``unit_behind`` tells it.
    """
    if len(cell) > LONGEST:
        return None
    cell = clean(cell)
    if _PLAIN.match(cell):
        return float(cell)
    if comma and _COMMA.match(cell):
        return float(cell.replace(".", "").replace(",", "."))
    if not comma and _THOUSANDS.match(cell):
        return float(cell.replace(",", ""))
    if cell.lower().lstrip("+-") in ("inf", "infinity"):
        return -math.inf if cell[0] == "-" else math.inf
    behind = _WITH_UNIT.match(cell)
    return number(behind[1], comma) if behind and behind[1] != cell else None


def unit_behind(cell: str) -> str:
    """The unit written behind a number in the same cell, or nothing."""
    behind = _WITH_UNIT.match(clean(cell[:LONGEST]))
    return behind[2] if behind and not _PLAIN.match(cell) else ""


def is_comma_number(cell: str) -> bool:
    cell = clean(cell) if len(cell) <= LONGEST else ""
    behind = _WITH_UNIT.match(cell)
    return bool(_COMMA.match(cell) or (behind and _COMMA.match(behind[1])))


def is_point_number(cell: str) -> bool:
    return bool(_PLAIN.match(cell)) and "." in cell


def is_time(cell: str) -> bool:
    return ":" in cell and bool(_STAMP.match(cell) or _ONLY_CLOCK.match(cell) or _MINUTES.match(cell))


def is_value(cell: str) -> bool:
    """Whether a cell could stand in a row of data: a number with either mark, a time, or missing."""
    return is_missing(cell) or is_time(cell) or number(cell, True) is not None or number(cell, False) is not None


def column_of(name: str, unit: str, cells: Sequence[str], comma: bool, lines: Sequence[int]) -> RawColumn:
    """The column of these cells, *lines* being the numbers of their lines in the file."""
    fast = _fast(cells, comma)
    if fast is not None:
        return RawColumn(name, fast, unit)
    if any(is_time(cell) for cell in cells[:LOOKED_AT]):
        times = times_of(cells)
        if times is not None:
            since, begins = times
            return RawColumn(name, since, unit, TIME, missing=_first_missing(cells, lines), begins=begins)
    found = [number(cell, comma) for cell in cells]
    values = within_reason(np.array([math.nan if value is None else value for value in found]))
    wrong = [i for i, value in enumerate(found) if value is None and not is_missing(cells[i])]
    numbers = sum(value is not None for value in found)
    if numbers == 0 or (len(wrong) > 1 and len(wrong) > (1.0 - MOSTLY) * len(cells)):
        at = wrong[0] if wrong else 0
        bad = (lines[at], cells[at]) if cells else None
        words = tuple(sorted(set(cells)))
        if len(words) <= FEW_WORDS and max(map(len, words), default=0) <= LONGEST:
            places = {word: float(i) for i, word in enumerate(words)}
            return RawColumn(name, np.array([places[cell] for cell in cells]), unit, TEXT, bad, words=words)
        return RawColumn(name, np.full(len(cells), math.nan), unit, TEXT, bad)
    if not unit:
        behind = {unit_behind(cell) for cell in cells[:200] if not is_missing(cell)}
        unit = behind.pop() if len(behind) == 1 else ""
    bad = (lines[wrong[0]], cells[wrong[0]]) if wrong else None
    gone = next((i for i, v in enumerate(values) if not math.isfinite(v) and i not in wrong[:1]), None)
    return RawColumn(name, values, unit, NUMBER, bad, None if gone is None else (lines[gone], cells[gone]))


def _fast(cells: Sequence[str], comma: bool) -> FloatArray | None:
    """All cells at once where they are plain finite numbers; None where one is not."""
    joined = "\n".join(cells)
    if "_" in joined or "n" in joined.lower().replace("\n", ""):  # 1_000, nan, inf
        return None
    if comma and "," in joined:
        if "." in joined:
            return None
        joined = joined.replace(",", ".")
    try:
        values = np.array(joined.split("\n"), dtype=np.str_).astype(np.float64)
    except ValueError:
        return None
    return values if values.size == len(cells) and (np.abs(values) < MAX_NUMBER).all() else None


def _first_missing(cells: Sequence[str], lines: Sequence[int]) -> tuple[int, str] | None:
    return next(((line, cell) for line, cell in zip(lines, cells, strict=True) if is_missing(cell)), None)


def times_of(cells: Sequence[str]) -> tuple[FloatArray, str] | None:
    """Seconds since the first cell, shape (rows,), NaN where missing, and the first as ISO 8601 where it has a date;
    None where some cell is no time.

    Dates are ISO 8601 or day first with dots; between slashes day and month are told apart by what makes sense. A clock
    without date that passes midnight goes on.
    """
    days: list[tuple[int, int, int, bool]] = []  # year and two numbers, and whether the year came first
    seconds = np.full(len(cells), math.nan)
    dated: bool | None = None
    for i, cell in enumerate(cells):
        if is_missing(cell):
            days.append((0, 0, 0, True))
            continue
        stamp, clock, short = _STAMP.match(cell), _ONLY_CLOCK.match(cell), _MINUTES.match(cell)
        if dated is not None and dated is not (stamp is not None):
            return None
        if stamp:
            dated = True
            if stamp[1]:
                days.append((int(stamp[1]), int(stamp[2]), int(stamp[3]), True))
            else:
                year = int(stamp[7]) + (2000 if len(stamp[7]) == 2 else 0)
                days.append((year, int(stamp[4]), int(stamp[6]), False))
            seconds[i] = _clock_s(stamp.group(8, 9, 10, 11, 12)) - _zone_s(stamp[13])
        elif clock:
            dated = False
            seconds[i] = _clock_s(clock.group(1, 2, 3, 4, 5))
        elif short:
            dated = False
            seconds[i] = 60.0 * int(short[1]) + int(short[2]) + float(f"0.{short[3]}")
        else:
            return None
    known = np.flatnonzero(np.isfinite(seconds))
    if not known.size:
        return None
    if dated:
        with_days = _with_days(seconds, days, any("." in cell[:6] for cell in cells[:5]))
        if with_days is None:
            return None
        times, day = with_days
        first = float(times[known[0]])
        if day < 1:  # a clock's year 0 is no date
            return times - first, ""
        zone = _STAMP.match(cells[known[0]])
        begin = datetime.fromordinal(day) + timedelta(seconds=round(first, 6))
        begin = begin.replace(tzinfo=UTC) if zone is not None and zone[13] else begin
        return times - first, begin.isoformat()
    steps = np.diff(seconds[known], prepend=seconds[known[:1]])
    seconds[known] += DAY_S * np.cumsum(steps < -0.5 * DAY_S)
    return seconds - seconds[known[0]], ""


def _with_days(
    seconds: FloatArray, days: list[tuple[int, int, int, bool]], dots: bool
) -> tuple[FloatArray, int] | None:
    """Seconds since midnight of the first day, under the order of day and month that makes sense, and that day."""
    orders = (True,) if dots else (True, False)
    best: tuple[FloatArray, int] | None = None
    for day_first in orders:
        known: dict[tuple[int, int, int, bool], int] = {}
        try:
            for key in days:
                if key[0] and key not in known:
                    year, one, two, iso = key
                    month, day = (one, two) if iso or not day_first else (two, one)
                    known[key] = date(year, month, day).toordinal()
        except ValueError:
            continue
        first = min(known.values(), default=0)  # a year 0 is none
        times = seconds + DAY_S * np.array([known.get(key, first) - first for key in days])
        if best is None or np.nanmax(times) - np.nanmin(times) < np.nanmax(best[0]) - np.nanmin(best[0]):
            best = times, first
    return best


def _clock_s(parts: tuple[str | None, ...]) -> float:
    hours, minutes, seconds, fraction, half = parts
    hour = int(hours or 0)
    if half:
        hour = hour % 12 + (12 if half.lower() == "pm" else 0)
    return 3600.0 * hour + 60.0 * int(minutes or 0) + int(seconds or 0) + float(f"0.{fraction or 0}")


def _zone_s(zone: str | None) -> float:
    if zone is None or zone[0] not in "+-":
        return 0.0
    digits = zone[1:].replace(":", "")
    return (1.0 if zone[0] == "+" else -1.0) * (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:]))
