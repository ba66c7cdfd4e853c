"""The measured column of a foreign table: its unit, resolution, turn, and whether it is a mean."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from fiohost.bench.log import FOUND
from fiohost.errors import ConfigError
from fiohost.importing import roles
from fiohost.importing.differences import over_rows
from fiohost.importing.found import Answers, Found, Unknown
from fiohost.importing.grid import COUNTER_TURNS, quantum_of, turn_of, wrap_of
from fiohost.importing.map import NEIGHBOURS, TableMap
from fiohost.importing.raw import FloatArray, RawColumn, RawTable
from fiohost.importing.roles import COUNT_WORDS, SPEED_WORDS, Head
from fiohost.importing.units import MAP_UNITS, unit_of
from fiohost.settings import nearest

COARSE = 2000.0  # levels of a speed over its range: fewer come from counted pulses, a mean since the row before
TURN = {"deg/s": 360.0, "rad/s": 2.0 * np.pi, "rpm": 60.0, "rev/s": 1.0}  # one turn a second
WHOLE, MOST_COUNTS = 0.1, 1e5  # readings are so near to whole counts, of so many a turn at most
TURN_PATTERNS = (
    r"(\d{2,7})\s*(?:counts?|cpr|ppr|ticks?|inc\w*|pulses?|impulse?|imp|striche|lines)?\.?\s*(?:/|per|pro|je)\s*(?:rev\w*|turn|umdr\w*|u\b)",
    r"\b(?:cpr|ppr|counts[ _]per[ _](?:rev\w*|turn)|ticks[ _]per[ _]rev\w*|inkremente)\D{0,6}(\d{2,7})",
    r"(\d{2,7})\s*(?:cpr|ppr)\b",
)


def sensor_of(
    raw: RawTable,
    output: Head,
    columns: Sequence[RawColumn],
    answers: Answers,
    found: Found,
    tick_s: float,
    by_speed: Callable[[float], tuple[float, str] | None] = lambda wrap: None,
) -> TableMap | None:
    """The part of the map that is the output's; *columns* are its column in all tables of a bench: its sensor is one,
    and what one table does not show another may. *by_speed* gives the counts of a turn that a speed beside them
    tells, by where the counter begins anew.
    """
    column = output.column
    values = np.concatenate([c.values[np.isfinite(c.values)] for c in columns])
    whole = bool(values.size) and bool(np.all(values == np.rint(values)))
    unit, scale = _output_unit(output, answers, columns, values, whole, found)
    if not unit:
        kinds = "rpm, deg/s, rad/s" if output.words & SPEED_WORDS else "deg, rad, counts; deg/s, rpm, rad/s; m"
        what = f"the unit of the output {column.name!r} ({kinds})"
        found.unknown.append(Unknown("unit", what, "--unit", tuple(MAP_UNITS)))
        return None
    quantum = min((q for q in (quantum_of(c.values) for c in columns) if q > 0.0), default=0.0) * abs(scale)
    angle = MAP_UNITS[unit][0] == "angle"
    wrap = max(wrap_of(c.values * scale, unit) for c in columns) if angle else 0.0
    turn = 0.0
    if unit in ("counts", "counts/s"):
        turn = answers.counts_per_rev or _counts_per_rev(raw, output)
        if not turn and (not wrap or wrap in COUNTER_TURNS) and (told := by_speed(wrap)):
            turn, speed = told
            said = f"{turn:g} counts of {column.name!r} make a turn, as {speed!r} says"
            found.assumed.append(f"{said} (--counts-per-rev)")
        if not turn and (not wrap or wrap in COUNTER_TURNS):
            found.unknown.append(
                Unknown("counts_per_rev", f"how many counts of {column.name!r} make a turn", "--counts-per-rev")
            )
            return None
        if not turn:
            found.assumed.append(f"{column.name!r} begins anew at {wrap:g} counts, which is taken as a turn")
            turn = wrap
        quantum = max(quantum, 1.0) if unit == "counts" and whole else quantum
    quantity = MAP_UNITS[unit][0]
    span = float(np.ptp(values) * abs(scale)) if values.size else 0.0
    coarse = quantity == "speed" and quantum > 0.0 and span / quantum < COARSE and quantum * 1000.0 > span
    counts = 0 if coarse or quantity != "speed" else _counts_of_a_step(unit, values * abs(scale), quantum, tick_s)
    quantum = TURN[unit] / (counts * tick_s) if counts else quantum
    rows, ahead = over_rows(columns, quantum / abs(scale)) if counts else (1, 0)
    average = NEIGHBOURS if ahead else "previous_interval" if coarse or counts else "instant"
    parts = [f"output: {column.name!r}, {quantity} in {unit}" + (f" times {1 / scale:g}" if scale != 1.0 else "")]
    parts += (
        ["resolution 1 count" if quantum == 1 and unit == "counts" else f"resolution {quantum:.6g} {unit}"]
        if quantum
        else []
    )
    parts += [f"wraps at {wrap:g} {unit}"] if wrap else []
    parts += [f"{turn:g} counts a turn"] if turn else []
    if coarse:
        found.assumed.append(f"so coarse a speed as {column.name!r} is counted: the mean since the row before")
    elif rows > 1:
        where = "from the row before to the next" if ahead else f"over the {rows} rows before"
        found.assumed.append(f"{column.name!r} errs as means {where} do, and is taken apart (average in a map)")
    elif counts:
        said = f"a step of {column.name!r} is one of {counts} counts of a turn a row"
        found.assumed.append(f"{said}: the mean since the row before (average in a map)")
    found.lines.append(", ".join(parts))
    return TableMap(
        name=FOUND, output_column=column.name, unit=unit, output_scale=scale, average=average,
        average_rows=1 if ahead else rows, quantum=quantum, wrap=wrap,
        counts_per_rev=turn if turn and turn != wrap else 0.0,
    )  # fmt: skip


def _counts_of_a_step(unit: str, speeds: FloatArray, quantum: float, tick_s: float) -> int:
    """The whole number of counts of a turn of which one a row makes a step of speeds (n), 0 where there is none. A
    power of ten is the step of a display.
    """
    if unit not in TURN or min(quantum, tick_s) <= 0.0 or f"{quantum:.3e}".startswith("1.000"):
        return 0
    counts = round(TURN[unit] / (quantum * tick_s))
    if not 1 <= counts <= MOST_COUNTS:
        return 0
    steps = speeds * (counts * tick_s / TURN[unit])
    return counts if float(np.quantile(np.abs(steps - np.rint(steps)), 0.99)) < WHOLE else 0


def _output_unit(
    output: Head, answers: Answers, columns: Sequence[RawColumn], values: FloatArray, whole: bool, found: Found
) -> tuple[str, float]:
    """The map's unit of the output and the factor to it, "" where it is not known."""
    if answers.unit is not None:
        said = unit_of(answers.unit)
        base = answers.unit if answers.unit in MAP_UNITS else said.base if said else ""
        if base not in MAP_UNITS:
            raise ConfigError(f"unknown unit {answers.unit[:40]!r}; {nearest(answers.unit, MAP_UNITS)}")
        return base, 1.0 if answers.unit in MAP_UNITS or said is None else said.scale
    if output.unit is not None and output.unit.base in MAP_UNITS:
        return output.unit.base, output.unit.scale
    name = output.column.name
    if output.words & {"drehzahl", "rpm"}:
        found.assumed.append(f"{name!r} is in rpm")
        return "rpm", 1.0
    if output.words & SPEED_WORDS:
        return "", 1.0
    if whole and output.words & COUNT_WORDS:
        found.assumed.append(f"{name!r}, whole numbers, are counts")
        return "counts", 1.0
    turn = next((t for t in (turn_of(c.values[np.isfinite(c.values)]) for c in columns) if t), "")
    if turn and not (whole and turn == "rad"):
        found.assumed.append(f"{name!r} is in {turn}, since it begins anew after a turn of that size")
        return turn, 1.0
    if whole and any(wrap_of(c.values, "counts") for c in columns) and output.score(roles.OUTPUT) > 2.0:
        found.assumed.append(f"{name!r}, whole numbers that begin anew, are counts")
        return "counts", 1.0
    return "", 1.0


def _counts_per_rev(raw: RawTable, output: Head) -> float:
    texts = [output.column.name, output.column.unit, *raw.titles]
    for pattern in TURN_PATTERNS:
        for text in texts:
            told = re.search(pattern, text, re.IGNORECASE)
            if told:
                return float(told[1])
    return 0.0
