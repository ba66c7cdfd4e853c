"""What a foreign table is, found without a map: roles by heads and units, scales and sensor by the numbers.

What is certain is said, what is likely is said as assumed, and what nobody can know is asked for, never guessed: the
unit of a nameless number, the voltage of full scale behind a ratio, the counts of a turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fiohost.bench.log import FOUND
from fiohost.errors import ConfigError, DataError
from fiohost.files import shortened
from fiohost.importing import roles
from fiohost.importing import units as u
from fiohost.importing.clock import Clock, clock_of
from fiohost.importing.direction import Driven, direction_of
from fiohost.importing.found import Answers, Found, Unknown
from fiohost.importing.map import LEAVE_OUT, REFUSE, Beside, TableMap
from fiohost.importing.raw import TEXT, FloatArray, RawColumn, RawTable
from fiohost.importing.roles import SPEED_WORDS, Head, head_of
from fiohost.importing.scale import Scale, scale_of
from fiohost.importing.sensor import sensor_of
from fiohost.importing.turn import turn_by_speed
from fiohost.importing.units import MAP_UNITS
from fiohost.settings import nearest

BACKWARDS = 0.2  # share of strong forward command during which the motor turns backwards
UNSIGNED_SHARE = 0.05  # of the rows with a negative command and a positive speed
EVEN_ROWS, EVEN_STEP, EVEN_SHARE = 20, 0.3, 0.95  # rows, and of a step how far and how often it may differ
MOST_SAID = 400  # characters of a sentence with names in it
LIKELY = 2.5  # points by which an angle may be less sure than a speed and is still taken


@dataclass(frozen=True)
class Understanding:
    """A map and how it was found; ``table_map`` is None where something is unknown."""

    table: RawTable
    table_map: TableMap | None
    lines: tuple[str, ...]
    assumed: tuple[str, ...]
    unknown: tuple[Unknown, ...]
    answers: Answers = field(default_factory=Answers)

    @property
    def certain(self) -> TableMap:
        """The map. Raises DataError saying what is unknown, and what would say it."""
        if self.table_map is None:
            what = " and ".join(one.what for one in self.unknown)
            options = ", ".join(dict.fromkeys(one.option for one in self.unknown if one.option))
            says = f"; say it with {options}, or write a map" if options else "; a map can say it"
            raise DataError(f"{self.table.path}: unknown is {what}{says}")
        return self.table_map

    @property
    def sentences(self) -> list[str]:
        """All that was found and assumed, for people."""
        return [*self.lines, *(f"assumed: {text}" for text in self.assumed)]


def understand(raw: RawTable, answers: Answers | None = None, others: Sequence[RawTable] = ()) -> Understanding:
    """Find out what *raw* is. *others* are further tables of the bench: a command of the same name has one scale in all
    of them, and those of the same columns have one sensor.

    Raises ConfigError for an answer that does not fit the table.
    """
    answers = answers or Answers()
    for key in ("time", "command", "output"):
        name = getattr(answers, key)
        if name is not None and name not in raw.names:
            raise ConfigError(f"{raw.path} has no column {name!r}; {nearest(name, raw.names)}")
    heads = [head_of(column) for column in raw.columns if column.kind != TEXT]
    found = Found()
    chosen = [answers.command, answers.output]
    if not raw.named and None in chosen:
        shown = ", ".join(raw.names[:6])
        found.unknown.append(
            Unknown("names", f"what its columns are, since no row has names ({shown})", "--command and --measured")
        )
        return _done(raw, None, found, answers)

    clock = _clock(raw, heads, answers, found)
    output = _output(raw, heads, answers, found)
    command = _command(raw, heads, answers, found, output)
    if output is None or command is None or clock is None:
        return _done(raw, None, found, answers)
    alike = [other for other in others if other.names == raw.names]
    needs = [name for name in (command.column.name, output.column.name, clock.column) if name]
    tables = (raw, *(t for t in alike if all(t.column(n).kind == raw.column(n).kind for n in needs)))
    sensor = sensor_of(
        raw, output, _columns(output, alike), answers, found, clock.tick_s,
        by_speed=lambda wrap: turn_by_speed(tables, heads, output.column.name, wrap, clock),
    )  # fmt: skip
    scale = _scale(raw, command, _columns(command, others), heads, answers, found)
    if sensor is None or scale is None:
        return _done(raw, None, found, answers)
    driven = [_driven(table, command, output, sensor, scale) for table in tables]
    duty, speed = driven[0].duty, driven[0].speed
    direction = direction_of(driven, found)
    if direction is not None:
        duty = duty * direction.ways(raw.column(direction.column))
    signed = _signs(raw, command, output, sensor, duty, speed, found)
    beside = _beside(heads, found)
    needed = [c for c in (clock.column, command.column.name, output.column.name, *(b.column for b in beside)) if c]
    needed += [direction.column] if direction else []
    missing = any(raw.column(name).missing for name in needed)
    table_map = replace(
        sensor, name=FOUND, time_column=clock.column, time_scale=clock.scale, time_wrap=clock.wrap,
        sample_time_s=clock.sample_time_s, command_column=command.column.name, command_scale=scale.scale,
        full_scale_V=scale.full_scale_V, command_unit=scale.unit, signed=signed, beside=beside,
        sign_column=direction.column if direction else None, forward=direction.forward if direction else 1.0,
        backward=direction.backward if direction else None, missing=LEAVE_OUT if missing else REFUSE,
    )  # fmt: skip
    unused = [name for name in raw.names if name not in found.used]
    if unused:
        found.lines.append(f"not used: {', '.join(unused[:8])}{' ...' if len(unused) > 8 else ''}")
    return _done(raw, None if found.unknown else table_map, found, answers)


def _done(raw: RawTable, table_map: TableMap | None, found: Found, answers: Answers) -> Understanding:
    form = f"{raw.rows} rows of {len(raw.columns)} columns; {raw.form}"
    lines, assumed = ([shortened(line, MOST_SAID) for line in of] for of in ((form, *found.lines), found.assumed))
    return Understanding(raw, table_map, tuple(lines), tuple(assumed), tuple(found.unknown), answers)


def _clock(raw: RawTable, heads: Sequence[Head], answers: Answers, found: Found) -> Clock | None:
    if answers.sample_time_s is not None and answers.time is None:
        found.lines.append(f"time: no column, rows {answers.sample_time_s:g} s apart")
        return Clock(None, sample_time_s=answers.sample_time_s, tick_s=answers.sample_time_s)
    likely = [h for h in heads if h.column.name == answers.time] if answers.time else []
    if not likely:
        likely = sorted((h for h in heads if h.score(roles.TIME) > 1.0), key=lambda h: -h.score(roles.TIME))
        likely = [h for h in likely if h.score(roles.TIME) >= max(h.score(r) for r in h.scores)]
        rising = [h for h in likely if _rises(h.column.values)]
        likely = rising or [h for h in likely if h.words & roles.WORDS[roles.TIME].keys()]
    if not likely:
        likely = [h for h in heads if h.column.name not in (answers.command, answers.output) and _even(h)][:1]
        found.assumed += [f"{h.column.name!r}, which rises in even steps, is the time" for h in likely]
    if not likely:
        what = "its time: no column is one of time"
        what += " (a table of readings is for fiohost diagnose --readings)" if raw.rows < EVEN_ROWS else ""
        found.unknown.append(Unknown("sample_time_s", what, "--time or --sample-time", tuple(raw.names)))
        return None
    clock = clock_of(likely[0], raw.path)
    found.used.add(likely[0].column.name)
    found.lines.append(clock.line)
    if clock.assumed:
        found.assumed.append(clock.assumed)
    return clock


def _even(head: Head) -> bool:
    """Whether a column of which nothing is said rises as times do: in even steps that are no whole numbers."""
    values = head.column.values
    if head.role or len(values) < EVEN_ROWS or not np.isfinite(values).all():
        return False
    steps = np.diff(values)
    even = steps.min() > 0.0 and float(np.mean(np.abs(steps / np.median(steps) - 1.0) < EVEN_STEP)) > EVEN_SHARE
    return bool(even) and not bool(np.all(values == np.rint(values)))


def _rises(values: FloatArray) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    return bool(steps.size) and float(np.mean(steps >= 0)) > 0.98 and float(steps.sum()) > 0.0


def _output(raw: RawTable, heads: Sequence[Head], answers: Answers, found: Found) -> Head | None:
    if answers.output is not None:
        found.used.add(answers.output)
        return next((h for h in heads if h.column.name == answers.output), None)
    likely = [h for h in heads if h.role == roles.OUTPUT and h.column.name not in (*found.used, answers.command)]
    if not likely:
        found.unknown.append(
            Unknown("output", f"which column is measured ({_shown(raw)})", "--measured", tuple(raw.names))
        )
        return None
    order = {u.ANGLE: 0, u.POSITION: 1, u.SPEED: 2}
    best = max(h.score(roles.OUTPUT) for h in likely)
    near = [h for h in likely if h.score(roles.OUTPUT) >= best - LIKELY]
    first = min(near, key=lambda h: (order.get(_quantity(h), 3), -h.score(roles.OUTPUT)))
    same = [
        h
        for h in near
        if h is not first
        and _quantity(h) == _quantity(first)
        and h.score(roles.OUTPUT) == first.score(roles.OUTPUT)
        and not (_unit_text(h) != _unit_text(first) and _unit_text(h) and _unit_text(first))
    ]
    if same:
        names = " or ".join(repr(h.column.name) for h in (first, *same))
        found.unknown.append(Unknown("output", f"which column is the output, {names}", "--measured", tuple(raw.names)))
        return None
    found.used.add(first.column.name)
    return first


def _quantity(head: Head) -> str:
    if head.unit is not None:
        return head.unit.measures
    return u.SPEED if head.words & SPEED_WORDS else u.ANGLE if head.score(roles.OUTPUT) > 2.0 else ""


def _unit_text(head: Head) -> str:
    return head.unit.base if head.unit else ""


def _command(raw: RawTable, heads: Sequence[Head], answers: Answers, found: Found, output: Head | None) -> Head | None:
    if answers.command is not None:
        found.used.add(answers.command)
        return next((h for h in heads if h.column.name == answers.command), None)
    taken = {*found.used, output.column.name if output else ""}
    likely = [h for h in heads if h.role == roles.COMMAND and h.column.name not in taken]
    if not likely:
        likely = [h for h in heads if h.role == roles.TORQUE and h.column.name not in taken]
    if not likely:
        found.unknown.append(
            Unknown("command", f"which column is the command ({_shown(raw)})", "--command", tuple(raw.names))
        )
        return None
    best = max(max(h.score(roles.COMMAND), h.score(roles.TORQUE)) for h in likely)
    first = [h for h in likely if max(h.score(roles.COMMAND), h.score(roles.TORQUE)) == best]
    if len(first) > 1:
        names = " or ".join(repr(h.column.name) for h in first)
        found.unknown.append(Unknown("command", f"which column is the command, {names}", "--command", tuple(raw.names)))
        return None
    found.used.add(first[0].column.name)
    return first[0]


def _columns(head: Head, others: Sequence[RawTable]) -> list[RawColumn]:
    """A column in all tables of a bench that have it."""
    same = [other.column(head.column.name) for other in others if head.column.name in other.names]
    return [head.column, *(c for c in same if c.kind == head.column.kind)]


def _scale(
    raw: RawTable, command: Head, columns: Sequence[RawColumn], heads: Sequence[Head], answers: Answers, found: Found
) -> Scale | None:
    supply = next((h for h in heads if h.role == roles.SUPPLY), None)
    scale = scale_of(command, columns, supply, raw.titles, answers.full_scale)
    if scale is None:
        largest = max(float(np.nanmax(np.abs(c.values))) for c in columns)
        what = f"the full scale of the command {command.column.name!r} (it reaches {largest:g})"
        found.unknown.append(Unknown("full_scale", what, "--full-scale"))
        return None
    found.lines.append(f"command: {command.column.name!r}, {scale.line}")
    if scale.assumed:
        found.assumed.append(scale.assumed)
    return scale


def _driven(table: RawTable, command: Head, output: Head, sensor: TableMap, scale: Scale) -> Driven:
    """Command and speed of a table, by the columns of one that is like it."""
    duty = table.column(command.column.name).values * scale.scale
    values = table.column(output.column.name).values * sensor.output_scale
    if sensor.wrap:
        values = np.unwrap(np.nan_to_num(values), period=sensor.wrap)
    return Driven(table, duty, values if sensor.quantity == "speed" or len(values) < 2 else np.gradient(values))


def _signs(
    raw: RawTable, command: Head, output: Head, sensor: TableMap, duty: FloatArray, speed: FloatArray, found: Found
) -> bool:
    """Whether the output has a sign; a command without one on a motor that turned both ways is unknown."""
    whole = np.isfinite(duty) & np.isfinite(speed)
    duty, speed = duty[whole], speed[whole]
    if not duty.size:
        return True
    fast = max(float(np.quantile(np.abs(speed), 0.9)), 1e-12)
    if sensor.quantity == "speed" and speed.min() >= -0.5 * max(sensor.quantum, 1e-9):
        against = float(np.mean((duty < -1.0) & (speed > 0.1 * fast)))
        if against > UNSIGNED_SHARE:
            found.assumed.append(
                f"{output.column.name!r} has no sign: it takes that of the command, turned at standstill"
            )
            return False
    strong = duty > 0.5 * max(float(duty.max()), 1e-12)
    if duty.min() >= 0.0 and strong.any() and float(np.mean(speed[strong] < -0.2 * fast)) > BACKWARDS:
        forward = float(np.mean(speed[strong] > 0.2 * fast))
        if forward > BACKWARDS:
            what = f"the sign of the command {command.column.name!r}: it has none, and the motor turned both ways"
            found.unknown.append(Unknown("command", what, "--command", tuple(raw.names)))
    return True


def _beside(heads: Sequence[Head], found: Found) -> tuple[Beside, ...]:
    """Measured columns that are kept beside the output."""
    kept: list[Beside] = []
    for role, measures, name in (
        (roles.CURRENT, u.CURRENT, "current_A"),
        (roles.SUPPLY, u.VOLTAGE, "supply_V"),
        (roles.TEMPERATURE, u.TEMPERATURE, "temperature_C"),
        (roles.TORQUE, u.TORQUE, "torque_Nm"),
        (roles.REFERENCE, u.ANGLE, "ref_deg"),
    ):
        likely = [
            h for h in heads if h.role == role and h.unit is not None and h.unit.measures == measures
            and h.column.name not in found.used and not h.column.missing and not h.column.bad
        ]  # fmt: skip
        if len(likely) != 1 or (likely[0].unit and likely[0].unit.base == "counts"):
            continue
        unit = likely[0].unit
        assert unit is not None
        factor = unit.scale * (MAP_UNITS[unit.base][2] if unit.base in MAP_UNITS else 1.0)
        kept.append(Beside(likely[0].column.name, name, factor))
        found.used.add(likely[0].column.name)
        found.lines.append(f"beside: {likely[0].column.name!r}, kept as {name}")
    return tuple(kept)


def _shown(raw: RawTable) -> str:
    return ", ".join(raw.names[:8])[:160] + (" ..." if len(raw.names) > 8 else "")


def map_file_of(log: Path) -> Path:
    """The map that is written beside a log."""
    return log.with_name(f"{log.stem}.map.toml")
