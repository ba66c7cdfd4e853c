"""A foreign table and its map become a log, in memory or as a file. Both go through one text, so that they are one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fiohost import __version__
from fiohost.bench.log import IMPORTED, Log
from fiohost.bench.table_log import log_text, write_log
from fiohost.errors import DataError, LogError
from fiohost.files import Output
from fiohost.importing.differences import since_the_row_before
from fiohost.importing.direction import STILL, Direction, meaning, values_of
from fiohost.importing.map import REFUSE, TableMap
from fiohost.importing.raw import MAX_NUMBER, NUMBER, TEXT, FloatArray, RawColumn, RawTable
from fiohost.importing.read import read_raw
from fiohost.importing.times import spaced, times_s
from fiohost.settings import counted

DUTY_TOLERANCE_PCT = 0.01  # a command printed with few digits may exceed full scale by its rounding
AMBIGUOUS_STEP = 0.4  # of a turn between rows: the shortest path may be the wrong one
MOST_MISSING = 0.5  # of the rows
LOOK_AHEAD = 6  # rows in which a speed must not fall further at its minimum
TIME_DIGITS = 9  # after the point: a nanosecond
DIGITS = 14  # that are significant: the fifteenth and later ones are what a change of unit leaves


def log_from_table(table: Path, table_map: TableMap) -> Log:
    """Make a log of a foreign table in memory. Raises LogError or DataError where the table does not fit the map.

    The log's ``path`` and ``sha256`` are those of the table, so that the same table in two roles is recognised.
    """
    return log_from_raw(read_raw(table, table_map.columns), table_map)


def log_from_raw(raw: RawTable, table_map: TableMap, understood: Sequence[str] = ()) -> Log:
    """The same for a table that has been read; *understood* are sentences on a map that was found, not given."""
    columns, metadata, dropped = _convert(raw, table_map, understood)
    text = log_text(columns, metadata).decode()
    return Log.parse(text, path=raw.path, sha256=raw.sha256, dropped=dropped)


def import_table(table: Path, table_map: TableMap, output: Output) -> Log:
    """Write the log of a foreign table to *output*, whole or not at all, and return it. Raises FiohostError."""
    return import_raw(read_raw(table, table_map.columns), table_map, output)


def import_raw(raw: RawTable, table_map: TableMap, output: Output, understood: Sequence[str] = ()) -> Log:
    """The same for a table that has been read."""
    columns, metadata, dropped = _convert(raw, table_map, understood)
    log = Log.read(write_log(output, columns, metadata))
    return log if not dropped else replace(log, dropped=(*dropped, *log.dropped))


def _convert(
    raw: RawTable, table_map: TableMap, understood: Sequence[str]
) -> tuple[dict[str, FloatArray], dict[str, str], tuple[str, ...]]:
    """The log's columns and metadata, and notes on what was dropped or is doubtful (missing ticks the log notes)."""
    notes = list(raw.notes)
    direction = table_map.direction
    way = direction.column if direction else None
    columns = {name: _checked(raw.column(name), raw, table_map) for name in table_map.columns if name != way}
    if direction is not None:
        columns[direction.column] = _ways(raw.column(direction.column), direction, raw, table_map)
    keep = np.all([np.isfinite(values) for values in columns.values()], axis=0)
    if not keep.all():
        gone = int(np.count_nonzero(~keep))
        if gone > MOST_MISSING * raw.rows:
            raise DataError(f"{raw.path}: {gone} of {raw.rows} rows have an empty cell in a column that is needed")
        notes.append(f"{counted(gone, 'row')} with an empty cell (the first is row {int(np.argmin(keep)) + 1})")
    columns = {name: values[keep] for name, values in columns.items()}
    rows = int(np.count_nonzero(keep))
    if rows == 0:
        raise LogError(f"{raw.path} has no row of numbers")

    if table_map.time_column is None:
        time_s, sample_time_s = np.arange(rows, dtype=np.float64) * table_map.sample_time_s, table_map.sample_time_s
    else:
        time_s, moved = times_s(columns[table_map.time_column], table_map, raw.path)
        notes += moved
        first = np.concatenate(([True], np.diff(time_s) > 0))
        if not first.all():
            notes.append(f"{int(np.count_nonzero(~first))} rows that repeat the time of the row before")
            columns = {name: values[first] for name, values in columns.items()}
            time_s, rows = time_s[first], int(np.count_nonzero(first))
        sample_time_s, jitter = spaced(time_s, raw.path)
        notes += [jitter] if jitter else []
    duty_pct = _duty(columns, rows, table_map, raw.path)
    output = columns[table_map.output_column] * table_map.output_scale + table_map.output_offset
    if table_map.wrap:
        output, doubt = _unwrap(output, table_map.wrap)
        notes += [doubt] if doubt else []
    output = output * table_map.output_factor
    if not table_map.signed:
        output = signed_by(output, duty_pct)
    rows_of, ahead = table_map.over_rows
    if rows_of > 1:
        step, gaps = table_map.quantum * table_map.output_factor, np.rint(np.diff(time_s) / sample_time_s) != 1.0
        found = None if step <= 0.0 or gaps.any() else since_the_row_before(output, step, rows_of, ahead)
        if found is None:
            notes.append(f"that speeds are taken over {rows_of} rows: some are missing, or speeds have no whole steps")
            table_map = replace(table_map, average="instant")
        else:
            output = found
            table_map = replace(table_map, average="previous_interval", quantum=rows_of * table_map.quantum)
    written = {"duty_pct": duty_pct, table_map.log_column: output}
    written |= {one.name: columns[one.column] * one.scale for one in table_map.beside}
    written = {"time_s": np.round(time_s, TIME_DIGITS)} | {k: significant(v, DIGITS) for k, v in written.items()}
    return written, dict(_metadata(raw, table_map, sample_time_s, understood)), tuple(notes)


def _metadata(
    raw: RawTable, table_map: TableMap, sample_time_s: float, understood: Sequence[str]
) -> list[tuple[str, str]]:
    factor = table_map.output_factor
    turn = table_map.turn if table_map.unit == "counts" else 0.0
    return [
        ("schema", "fiohost.log/1"),
        ("target", IMPORTED),
        ("source", raw.path.name),
        ("source_sha256", raw.sha256),
        ("data_source", table_map.source),
        ("map", table_map.name),
        ("understood", "; ".join(understood)),
        ("sample_time_s", f"{sample_time_s:.12g}"),
        ("command_delay_ticks", str(table_map.delay_ticks)),
        ("pwm_hz", f"{table_map.pwm_hz:.12g}" if table_map.pwm_hz else ""),
        ("full_scale", f"{100.0 / abs(table_map.command_scale):.12g}"),
        ("full_scale_unit", table_map.command_unit),
        ("output_quantum", f"{table_map.quantum * factor:.12g}"),
        ("output_average", table_map.average),
        ("output_sign", "" if table_map.signed else "of the command"),
        ("counts_per_rev", f"{turn:.0f}" if turn and turn == round(turn) else ""),
        ("output_noise_rms", "" if table_map.noise_rms is None else f"{table_map.noise_rms * factor:.12g}"),
        ("pos_reset", str(not table_map.common_zero).lower()),
        ("start_time", raw.column(table_map.time_column).begins if table_map.time_column else ""),
        ("host_version", __version__),
    ]


def _checked(column: RawColumn, raw: RawTable, table_map: TableMap) -> FloatArray:
    """The numbers of a needed column. Raises LogError where cells are none."""
    for at, why in ((column.bad, "not a number"), (column.missing if table_map.missing == REFUSE else None, "")):
        if at is None:
            continue
        line, cell = at
        what = f"{cell[:40]!r}" if cell else "an empty cell"
        number_like = len(cell) > 2 and cell[0].lower() in "ni+-.0123456789"
        why = why or (f"not a finite number below {MAX_NUMBER:g}" if number_like else "not a number")
        raise LogError(
            f"{raw.path} line {line}, column {column.name!r}: {what} is {why}; a missing sample must be a missing row"
        )
    if column.kind == TEXT:
        raise LogError(f"{raw.path}: column {column.name!r} holds text, not numbers")
    if column.kind != NUMBER and column.name != table_map.time_column:
        raise LogError(f"{raw.path}: column {column.name!r} holds times, not numbers")
    return column.values


def _ways(column: RawColumn, direction: Direction, raw: RawTable, table_map: TableMap) -> FloatArray:
    """Which way the command is, NaN where the cell is empty. Raises LogError and DataError where the column does not
    say it.
    """
    if column.kind == TEXT and not column.words:
        raise DataError(f"{raw.path}: column {column.name!r} has too many different words: it is no direction")
    values = column.values if column.kind == TEXT else _checked(column, raw, table_map)
    both = direction.forward is not None and direction.backward is not None
    if column.kind != TEXT and not both and len(np.unique(values[np.isfinite(values)])) > 2:
        raise DataError(f"{raw.path}: column {column.name!r} has more than two values: it is no direction")
    given = [value for value in (direction.forward, direction.backward) if value is not None]
    there = sorted({v for v in values_of(column).tolist() if v in given or meaning(v) != STILL}, key=str)
    wordy = bool(column.words) or any(isinstance(value, str) for value in given)
    if wordy and there and not set(there) & set(given):
        shown = ", ".join(map(repr, there[:4]))
        raise DataError(f"{raw.path}: column {column.name!r} has {shown}: say which of them is [command] forward")
    return np.where(np.isfinite(values), direction.ways(column), np.nan)


def signed_by(speed: FloatArray, command: FloatArray) -> FloatArray:
    """A speed without sign with that of the command, shape (rows,): it turns at the slowest row after each reversal."""
    known = np.flatnonzero(command)
    if not known.size:
        return speed
    sign = np.sign(command[known])
    turns = known[1:][np.diff(sign) != 0]
    result = np.empty_like(speed)
    begin, way = 0, float(sign[0])
    for i, turn in enumerate(turns):
        end = int(turns[i + 1]) if i + 1 < len(turns) else len(speed)
        at = int(turn) + standstill(speed[int(turn) : end])
        result[begin:at] = way * speed[begin:at]
        begin, way = at, -way
    result[begin:] = way * speed[begin:]
    return result


def standstill(speed: FloatArray) -> int:
    """The row at which a speed without sign, shape (rows,), goes through zero: its first clear minimum."""
    for i in np.flatnonzero(speed < 0.5 * speed[0]):
        if speed[i] <= speed[i : i + LOOK_AHEAD].min():
            return int(i)
    return int(np.argmin(speed))


def significant(values: FloatArray, digits: int) -> FloatArray:
    """Numbers, shape (rows,), rounded to so many significant digits."""
    return np.array([float(f"{value:.{digits}g}") for value in values.tolist()])


def _duty(columns: dict[str, FloatArray], rows: int, table_map: TableMap, path: Path) -> FloatArray:
    command = (
        np.full(rows, table_map.constant_command)
        if table_map.command_column is None
        else columns[table_map.command_column]
    )
    duty_pct = command * table_map.command_scale
    if table_map.sign_column is not None:
        duty_pct = duty_pct * columns[table_map.sign_column]
    largest = float(np.abs(duty_pct).max())
    if largest > 100.0 + DUTY_TOLERANCE_PCT:
        raise DataError(
            f"{path}: the command reaches {largest:g} % of full scale; [command] scale = {table_map.command_scale:g} "
            "does not turn it into percent"
        )
    return np.clip(duty_pct, -100.0, 100.0)


def _unwrap(values: FloatArray, wrap: float) -> tuple[FloatArray, str]:
    """Undo wrapping at *wrap* by the shortest path; values that range wider than a turn are continuous already."""
    if np.ptp(values) > wrap:
        return values, ""
    unwrapped = np.unwrap(values, period=wrap)
    steps = np.abs(np.diff(unwrapped))
    if steps.size and float(steps.max()) > AMBIGUOUS_STEP * wrap:
        return unwrapped, f"the angle moves {steps.max() / wrap:.2f} of a turn between rows: its unwrapping is doubtful"
    return unwrapped, ""
