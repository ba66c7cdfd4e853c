"""Foreign tables become logs: a TOML map (schema ``fiohost.map/1``) says which column is time, command and output.

``import_table`` writes a log file, ``log_from_table`` gives the same log without a file. Both go through one text,
so that a table diagnosed directly and its imported log are the same data.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fiohost import __version__
from fiohost.bench.integrity import ended
from fiohost.bench.log import Log
from fiohost.bench.table import read_table
from fiohost.errors import DataError
from fiohost.files import write_output
from fiohost.settings import Table, find_config, read_toml

SCHEMA = "fiohost.map/1"
QUANTITIES = ("angle", "speed", "position")
AVERAGES = ("instant", "previous_interval")

# unit of the table -> (quantity, column of the log, factor to the log's unit); counts need the counts of a turn
UNITS: dict[str, tuple[str, str, float]] = {
    "deg": ("angle", "angle_deg", 1.0),
    "rad": ("angle", "angle_deg", 180.0 / math.pi),
    "counts": ("angle", "angle_deg", math.nan),
    "deg/s": ("speed", "speed_deg_s", 1.0),
    "rad/s": ("speed", "speed_deg_s", 180.0 / math.pi),
    "m/s": ("speed", "speed_m_s", 1.0),
    "m": ("position", "position_m", 1.0),
    "mm": ("position", "position_m", 1e-3),
}
DUTY_TOLERANCE_PCT = 0.01  # a command printed with few digits may exceed full scale by its rounding
AMBIGUOUS_STEP = 0.4  # of a turn between rows: the shortest path may be the wrong one


@dataclass(frozen=True)
class TableMap:
    """One map: where a table keeps time, command and output, and how to convert them."""

    name: str
    source: str  # where the data come from, for people
    time_column: str | None  # None: rows are sample_time_s apart
    time_scale: float  # to seconds
    sample_time_s: float  # 0: taken from the time column
    command_column: str | None  # None: constant_command throughout
    constant_command: float
    command_scale: float  # to percent of full scale
    command_unit: str  # unit of the command in the table, for people; "" where not said
    delay_ticks: int
    pwm_hz: float  # of the bridge, 0 where it is not known
    output_column: str
    unit: str
    average: str
    quantum: float  # in the table's unit, 0 if none or unknown
    wrap: float  # size of a turn in the table's unit, 0 where it does not wrap
    common_zero: bool  # the zero angle is the same place in every table made with this map
    noise_rms: float | None = None  # of the sensor beside its quantum, in the table's unit; None: estimated

    @classmethod
    def load(cls, name_or_path: str | Path) -> TableMap:
        """Read a map file, or a shipped one by name. Raises ConfigError for unknown keys, units and values."""
        path = find_config("maps", name_or_path)
        return cls.from_table(read_toml(path), path.stem)

    @classmethod
    def from_table(cls, top: Table, name: str) -> TableMap:
        """Check one parsed TOML table. Raises ConfigError."""
        top.schema(SCHEMA)
        source = top.text("source", "")
        time, command, output = (top.table(key, required=True) for key in ("time", "command", "output"))
        top.finish()

        _one_of(time, "column", "sample_time_s")
        sample_time_s = time.number("sample_time_s", low=1e-7, high=3600.0) if "sample_time_s" in time else 0.0
        time_column = time.text("column") if "column" in time else None
        time_scale = _nonzero(time, "scale", time.number("scale", 1.0, low=0.0))
        time.finish()

        _one_of(command, "column", "constant")
        command_column = command.text("column") if "column" in command else None
        constant = command.number("constant", 0.0)
        command_scale = _nonzero(command, "scale", command.number("scale", 1.0))
        command_unit = command.text("unit", "")
        delay_ticks = command.integer("delay_ticks", 0, low=0, high=10_000)
        pwm_hz = command.number("pwm_hz", low=10.0, high=1e6) if "pwm_hz" in command else 0.0
        command.finish()

        output_column = output.text("column")
        quantity = output.text("quantity", choices=QUANTITIES)
        unit = output.text("unit", choices=sorted(UNITS))
        if UNITS[unit][0] != quantity:
            fitting = [u for u, (q, _, _) in UNITS.items() if q == quantity]
            raise output.fail(f"unit {unit!r} is not a unit of {quantity}; known: {', '.join(fitting)}")
        average = output.text("average", "instant", choices=AVERAGES)
        if average == "previous_interval" and quantity != "speed":
            raise output.fail(f"average = 'previous_interval' is for a speed taken from counts, not for {quantity}")
        wrap = output.number("wrap", 0.0, low=0.0, high=1e9)
        if unit == "counts" and wrap == 0:
            raise output.fail("unit 'counts' needs wrap = counts per turn, else nobody knows the angle of a count")
        if wrap and quantity != "angle":
            raise output.fail(f"wrap is for an angle, not for a {quantity}")
        quantum = output.number("quantum", 1.0 if unit == "counts" else 0.0, low=0.0)
        common_zero = output.flag("common_zero", False)
        noise_rms = output.number("noise_rms", low=0.0) if "noise_rms" in output else None
        output.finish()
        return cls(
            name, source, time_column, time_scale, sample_time_s, command_column, constant, command_scale, command_unit,
            delay_ticks, pwm_hz, output_column, unit, average, quantum, wrap, common_zero, noise_rms,
        )  # fmt: skip

    @property
    def log_column(self) -> str:
        """Output column of the log: ``angle_deg``, ``speed_deg_s``, ``position_m`` or ``speed_m_s``."""
        return UNITS[self.unit][1]

    @property
    def output_factor(self) -> float:
        """From the table's unit to the log's."""
        return 360.0 / self.wrap if self.unit == "counts" else UNITS[self.unit][2]

    @property
    def columns(self) -> list[str]:
        """Names of the table's columns that are read."""
        names = [self.time_column, self.command_column, self.output_column]
        return list(dict.fromkeys(name for name in names if name is not None))


def log_from_table(table: Path, table_map: TableMap) -> Log:
    """Make a log of a foreign table in memory. Raises LogError or DataError where the table does not fit the map.

    The log's ``path`` and ``sha256`` are those of the table, so that the same table in two roles is recognised.
    """
    text, sha256, dropped = _convert(table, table_map)
    return Log.parse(text, path=table, sha256=sha256, dropped=dropped)


def import_table(table: Path, table_map: TableMap, output: Path) -> Log:
    """Write the log of a foreign table to *output*, whole or not at all, and return it. Raises FiohostError."""
    text, _, dropped = _convert(table, table_map)
    write_output(output, ended(text))
    log = Log.read(output)
    return log if not dropped else Log.parse(text, path=output, sha256=log.sha256, dropped=dropped)


def _convert(path: Path, table_map: TableMap) -> tuple[str, str, tuple[str, ...]]:
    """The log's text, the table's hash, and notes on what was dropped or is doubtful (missing ticks the log notes)."""
    table = read_table(path, table_map.columns)
    notes = list(table.dropped)
    time_s, sample_time_s, jitter = _times(table.columns, table.rows, table_map, path)
    if jitter:
        notes.append(jitter)
    duty_pct = _duty(table.columns, table.rows, table_map, path)
    output = table.columns[table_map.output_column]
    if table_map.wrap:
        output, doubt = _unwrap(output, table_map.wrap)
        if doubt:
            notes.append(doubt)
    output = output * table_map.output_factor

    metadata = {
        "schema": "fiohost.log/1",
        "target": "import",
        "source": path.name,
        "source_sha256": table.sha256,
        "data_source": table_map.source,
        "map": table_map.name,
        "sample_time_s": f"{sample_time_s:.12g}",
        "command_delay_ticks": str(table_map.delay_ticks),
        "pwm_hz": f"{table_map.pwm_hz:.12g}" if table_map.pwm_hz else "",
        "full_scale": f"{100.0 / abs(table_map.command_scale):.12g}",
        "full_scale_unit": table_map.command_unit,
        "output_quantum": f"{table_map.quantum * table_map.output_factor:.12g}",
        "output_average": table_map.average,
        "counts_per_rev": f"{table_map.wrap:.0f}" if table_map.unit == "counts" and table_map.wrap.is_integer() else "",
        "output_noise_rms": ""
        if table_map.noise_rms is None
        else f"{table_map.noise_rms * table_map.output_factor:.12g}",
        "pos_reset": str(not table_map.common_zero).lower(),
        "host_version": __version__,
    }
    lines = [f"# {key}: {_one_line(value)}\n" for key, value in metadata.items() if value]
    lines.append(f"time_s,duty_pct,{table_map.log_column}\n")
    lines += [f"{t:.15g},{u:.12g},{y:.12g}\n" for t, u, y in zip(time_s, duty_pct, output, strict=True)]
    return "".join(lines), table.sha256, tuple(notes)


def _times(
    columns: dict[str, NDArray[np.float64]], rows: int, table_map: TableMap, path: Path
) -> tuple[NDArray[np.float64], float, str]:
    """Times (s), the sample time (s), and a note where times jitter."""
    if table_map.time_column is None:
        return np.arange(rows, dtype=np.float64) * table_map.sample_time_s, table_map.sample_time_s, ""
    time_s = columns[table_map.time_column] * table_map.time_scale
    if rows < 2:
        raise DataError(f"{path} has one row: at least two are needed to know the sample time")
    steps = np.diff(time_s)
    if not np.all(steps > 0):
        row = int(np.argmin(steps > 0)) + 2
        raise DataError(
            f"{path}: time does not increase at row {row} of the data ({table_map.time_column} = "
            f"{columns[table_map.time_column][row - 1]:g}); sort the table or split it into records"
        )
    sample_time_s = _sample_time(time_s)
    jitter = float(np.abs(steps / sample_time_s - np.rint(steps / sample_time_s)).max())
    return time_s, sample_time_s, f"sample times jitter by up to {100 * jitter:.0f} % of a tick" if jitter > 0.1 else ""


def _sample_time(time_s: NDArray[np.float64]) -> float:
    """The tick of times that may be printed with few digits and miss rows: a straight line through time over tick.

    Ticks are counted with the median step at first and recounted as the line is known over twice as many rows; where
    the times do not lie on such a grid (no common tick) the mean or median step is the answer.
    """
    elapsed = time_s - time_s[0]
    median = float(np.median(np.diff(time_s)))
    step = median
    rows = 4
    while True:
        known = elapsed[:rows]
        ticks = np.rint(known / step)
        step = float(np.dot(known, ticks) / np.dot(ticks, ticks)) if ticks.any() else median
        if rows >= len(elapsed):
            break
        rows *= 2
    ticks = np.rint(elapsed / step)
    on_grid = float(np.std(elapsed / step - ticks)) < 0.2 and float(np.mean(np.diff(ticks) >= 1)) > 0.98
    if not on_grid:
        mean = float(elapsed[-1] / (len(elapsed) - 1))
        step = mean if abs(mean / median - 1.0) < 0.05 else median  # the mean, unless rows are missing
    return float(f"{step:.9g}")


def _duty(columns: dict[str, NDArray[np.float64]], rows: int, table_map: TableMap, path: Path) -> NDArray[np.float64]:
    command = (
        np.full(rows, table_map.constant_command)
        if table_map.command_column is None
        else columns[table_map.command_column]
    )
    duty_pct = command * table_map.command_scale
    largest = float(np.abs(duty_pct).max())
    if largest > 100.0 + DUTY_TOLERANCE_PCT:
        raise DataError(
            f"{path}: the command reaches {largest:g} % of full scale; [command] scale = {table_map.command_scale:g} "
            "does not turn it into percent"
        )
    return np.clip(duty_pct, -100.0, 100.0)


def _unwrap(values: NDArray[np.float64], wrap: float) -> tuple[NDArray[np.float64], str]:
    """Undo wrapping at *wrap* by the shortest path; values that range wider than a turn are continuous already."""
    if np.ptp(values) > wrap:
        return values, ""
    unwrapped = np.unwrap(values, period=wrap)
    steps = np.abs(np.diff(unwrapped))
    if steps.size and float(steps.max()) > AMBIGUOUS_STEP * wrap:
        return unwrapped, f"the angle moves {steps.max() / wrap:.2f} of a turn between rows: its unwrapping is doubtful"
    return unwrapped, ""


def _one_of(table: Table, first: str, second: str) -> None:
    if (first in table) == (second in table):
        raise table.fail(f"exactly one of {first!r} and {second!r} is needed")


def _nonzero(table: Table, key: str, value: float) -> float:
    if value == 0:
        raise table.fail(f"{key} must not be 0")
    return value


def _one_line(value: str) -> str:
    return re.sub(r"\s+", " ", value)[:500]
