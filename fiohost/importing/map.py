"""The map of a foreign table, schema ``fiohost.map/1``: which column is time, command and output, and their units."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

from fiohost.importing.direction import Direction, Value
from fiohost.importing.units import MAP_UNITS
from fiohost.settings import Table, find_config, read_toml

SCHEMA = "fiohost.map/1"
QUANTITIES = ("angle", "speed", "position")
NEIGHBOURS = "neighbours"  # a speed from the row before to the next
AVERAGES = ("instant", "previous_interval", NEIGHBOURS)
REFUSE, LEAVE_OUT = "refuse", "leave_out"
# Columns that a log may have beside its output; their units are in their names.
BESIDE = ("current_A", "supply_V", "temperature_C", "torque_Nm", "ref_deg", "voltage_V")


@dataclass(frozen=True)
class Beside:
    """A further column that is kept: its name in the table, its name in the log, and the factor to the log's unit."""

    column: str
    name: str
    scale: float = 1.0


@dataclass(frozen=True, kw_only=True)
class TableMap:
    """One map: where a table keeps time, command and output, and how to convert them.

    The output in ``unit`` is ``output_scale * column + output_offset``; quantum, wrap and noise are in that unit.
    """

    name: str
    output_column: str
    unit: str
    source: str = ""  # where the data come from, for people
    time_column: str | None = None  # None: rows are sample_time_s apart
    time_scale: float = 1.0  # to seconds
    time_wrap: float = 0.0  # of a counter of time that begins anew, in the table's unit
    sample_time_s: float = 0.0  # 0: taken from the time column
    command_column: str | None = None  # None: constant_command throughout
    constant_command: float = 0.0
    command_scale: float = 1.0  # to percent of full scale
    full_scale_V: float = 0.0  # 0: the scale is told
    command_unit: str = ""  # unit of the command in the table, for people; "" where not said
    sign_column: str | None = None  # of few values, where the command has no sign: which of them is forward
    forward: Value | None = 1.0
    backward: Value | None = None  # every other value, but words for standing still
    delay_ticks: int = 0
    pwm_hz: float = 0.0  # of the bridge, 0 where it is not known
    output_scale: float = 1.0
    output_offset: float = 0.0
    signed: bool = True  # False: a speed without sign, which takes that of the command
    average: str = "instant"
    average_rows: int = 1  # of a mean since the rows before; of a step of its readings one count is in all of them
    quantum: float = 0.0  # 0 if none or unknown
    wrap: float = 0.0  # size of a turn or counter, 0 where it does not wrap
    counts_per_rev: float = 0.0  # of counts; 0: as wrap
    common_zero: bool = False  # the zero angle is the same place in every table made with this map
    noise_rms: float | None = None  # of the sensor beside its quantum; None: estimated
    missing: str = REFUSE  # what becomes of rows with an empty cell
    beside: tuple[Beside, ...] = ()

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
        missing = top.text("missing", REFUSE, choices=(REFUSE, LEAVE_OUT))
        time, command, output = (top.table(key, required=True) for key in ("time", "command", "output"))
        beside = tuple(_beside(one) for one in top.tables("beside"))
        top.finish()

        _one_of(time, "column", "sample_time_s")
        sample_time_s = time.number("sample_time_s", low=1e-7, high=3600.0) if "sample_time_s" in time else 0.0
        time_column = time.text("column") if "column" in time else None
        time_scale = _nonzero(time, "scale", time.number("scale", 1.0, low=0.0))
        time_wrap = time.number("wrap", 0.0, low=0.0)
        time.finish()

        _one_of(command, "column", "constant")
        command_column = command.text("column") if "column" in command else None
        constant = command.number("constant", 0.0)
        full_scale_V = command.number("full_scale_V", low=1e-3, high=1e4) if "full_scale_V" in command else 0.0
        if full_scale_V and "scale" in command:
            raise command.fail("full_scale_V and scale say the same: give one of them")
        command_scale = _nonzero(command, "scale", command.number("scale", 1.0))
        command_unit = command.text("unit", "V" if full_scale_V else "")
        sign_column = command.text("sign_column") if "sign_column" in command else None
        forward, backward = (_value(command, key) for key in ("forward", "backward"))
        if sign_column is None and not (forward is None and backward is None):
            raise command.fail("forward and backward are values of the sign_column, which is not given")
        if forward is not None and forward == backward:
            raise command.fail("forward and backward are the same value")
        forward = 1.0 if forward is None and backward is None else forward
        delay_ticks = command.integer("delay_ticks", 0, low=0, high=10_000)
        pwm_hz = command.number("pwm_hz", low=10.0, high=1e6) if "pwm_hz" in command else 0.0
        command.finish()

        output_column = output.text("column")
        quantity = output.text("quantity", choices=QUANTITIES)
        unit = output.text("unit", choices=sorted(MAP_UNITS))
        if MAP_UNITS[unit][0] != quantity:
            fitting = [u for u, (q, _, _) in MAP_UNITS.items() if q == quantity]
            raise output.fail(f"unit {unit!r} is not a unit of {quantity}; known: {', '.join(fitting)}")
        average = output.text("average", "instant", choices=AVERAGES)
        if average != "instant" and quantity != "speed":
            raise output.fail(f"average = {average!r} is for a speed taken from counts, not for {quantity}")
        average_rows = output.integer("average_rows", 1, low=1, high=1000)
        if average_rows > 1 and average != "previous_interval":
            raise output.fail("average_rows is for average = 'previous_interval'")
        wrap = output.number("wrap", 0.0, low=0.0, high=1e10)
        counts_per_rev = output.number("counts_per_rev", 0.0, low=0.0, high=1e9)
        if unit in ("counts", "counts/s") and wrap == 0 and counts_per_rev == 0:
            raise output.fail(
                f"unit {unit!r} needs wrap = counts per turn where they wrap there, or counts_per_rev, else nobody "
                "knows the angle of a count"
            )
        if counts_per_rev and unit not in ("counts", "counts/s"):
            raise output.fail(f"counts_per_rev is for counts, not for {unit}")
        if wrap and quantity != "angle":
            raise output.fail(f"wrap is for an angle, not for a {quantity}")
        quantum = output.number("quantum", 1.0 if unit == "counts" else 0.0, low=0.0)
        if quantum == 0.0 and (average_rows > 1 or average == NEIGHBOURS):
            raise output.fail("a speed over several rows is taken apart by its steps: say its quantum")
        common_zero = output.flag("common_zero", False)
        noise_rms = output.number("noise_rms", low=0.0) if "noise_rms" in output else None
        output_scale = _nonzero(output, "scale", output.number("scale", 1.0))
        output_offset = output.number("offset", 0.0)
        signed = output.flag("signed", True)
        if not signed and quantity != "speed":
            raise output.fail(f"signed = false is for a speed without sign, not for {quantity}")
        output.finish()
        return cls(
            name=name, source=source, missing=missing, beside=beside,
            time_column=time_column, time_scale=time_scale, time_wrap=time_wrap, sample_time_s=sample_time_s,
            command_column=command_column, constant_command=constant,
            command_scale=100.0 / full_scale_V if full_scale_V else command_scale, full_scale_V=full_scale_V,
            command_unit=command_unit, sign_column=sign_column, forward=forward, backward=backward,
            delay_ticks=delay_ticks, pwm_hz=pwm_hz,
            output_column=output_column, unit=unit, output_scale=output_scale, output_offset=output_offset,
            signed=signed, average=average, average_rows=average_rows, quantum=quantum, wrap=wrap,
            counts_per_rev=counts_per_rev, common_zero=common_zero, noise_rms=noise_rms,
        )  # fmt: skip

    @property
    def over_rows(self) -> tuple[int, int]:
        """Over how many rows a speed is a difference, and how many of them come after its own."""
        return (2, 1) if self.average == NEIGHBOURS else (self.average_rows, 0)

    @property
    def quantity(self) -> str:
        """``angle``, ``speed`` or ``position``."""
        return MAP_UNITS[self.unit][0]

    @property
    def log_column(self) -> str:
        """Output column of the log: ``angle_deg``, ``speed_deg_s``, ``position_m`` or ``speed_m_s``."""
        return MAP_UNITS[self.unit][1]

    @property
    def turn(self) -> float:
        """Counts of a turn, 0 where the output is not in counts."""
        return (self.counts_per_rev or self.wrap) if self.unit in ("counts", "counts/s") else 0.0

    @property
    def output_factor(self) -> float:
        """From the map's unit to the log's."""
        return 360.0 / self.turn if self.turn else MAP_UNITS[self.unit][2]

    @property
    def direction(self) -> Direction | None:
        """What says which way the command is, where it has no sign."""
        return None if self.sign_column is None else Direction(self.sign_column, self.forward, self.backward)

    @property
    def columns(self) -> list[str]:
        """Names of the table's columns that are read."""
        names = [self.time_column, self.command_column, self.sign_column, self.output_column]
        names += [one.column for one in self.beside]
        return list(dict.fromkeys(name for name in names if name is not None))

    def to_toml(self, comments: tuple[str, ...] = ()) -> str:
        """The text of a map file, with *comments* above; :meth:`from_table` reads the same map from it."""
        lines = [f"# {' '.join(line.split())}" for line in comments]
        lines += [f'schema = "{SCHEMA}"']
        lines += [f"source = {_quoted(self.source)}"] if self.source else []
        lines += [f'missing = "{self.missing}"'] if self.missing != REFUSE else []
        lines += ["", "[time]"]
        if self.time_column is None:
            lines += [f"sample_time_s = {self.sample_time_s!r}"]
        else:
            lines += [f"column = {_quoted(self.time_column)}", f"scale = {self.time_scale!r}"]
            lines += [f"wrap = {self.time_wrap!r}"] if self.time_wrap else []
        lines += ["", "[command]"]
        lines += (
            [f"constant = {self.constant_command!r}"]
            if self.command_column is None
            else [f"column = {_quoted(self.command_column)}"]
        )
        lines += [f"unit = {_quoted(self.command_unit)}"] if self.command_unit else []
        lines += [f"full_scale_V = {self.full_scale_V!r}" if self.full_scale_V else f"scale = {self.command_scale!r}"]
        if self.sign_column is not None:
            lines += [f"sign_column = {_quoted(self.sign_column)}"]
            sides = (("forward", self.forward), ("backward", self.backward))
            lines += [f"{key} = {_quoted(v) if isinstance(v, str) else repr(v)}" for key, v in sides if v is not None]
        lines += [f"delay_ticks = {self.delay_ticks}"]
        lines += [f"pwm_hz = {self.pwm_hz!r}"] if self.pwm_hz else []
        lines += ["", "[output]", f"column = {_quoted(self.output_column)}", f'quantity = "{self.quantity}"']
        lines += [f'unit = "{self.unit}"']
        lines += [f"scale = {self.output_scale!r}"] if self.output_scale != 1.0 else []
        lines += [f"offset = {self.output_offset!r}"] if self.output_offset else []
        lines += [f'average = "{self.average}"', f"quantum = {self.quantum!r}"]
        lines += [f"average_rows = {self.average_rows}"] if self.average_rows > 1 else []
        lines += ["signed = false"] if not self.signed else []
        lines += [f"wrap = {self.wrap!r}"] if self.wrap else []
        lines += [f"counts_per_rev = {self.counts_per_rev!r}"] if self.counts_per_rev else []
        lines += ["common_zero = true"] if self.common_zero else []
        lines += [f"noise_rms = {self.noise_rms!r}"] if self.noise_rms is not None else []
        for one in self.beside:
            lines += [
                "",
                "[[beside]]",
                f"column = {_quoted(one.column)}",
                f'name = "{one.name}"',
                f"scale = {one.scale!r}",
            ]
        return "\n".join(lines) + "\n"


def _value(table: Table, key: str) -> Value | None:
    """A number or a text, None where there is none."""
    said = table.raw(key)
    return said if said is None or isinstance(said, str) else table.number(key)


def _beside(table: Table) -> Beside:
    found = Beside(
        table.text("column"), table.text("name", choices=BESIDE), _nonzero(table, "scale", table.number("scale", 1.0))
    )
    table.finish()
    return found


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _one_of(table: Table, first: str, second: str) -> None:
    if (first in table) == (second in table):
        raise table.fail(f"exactly one of {first!r} and {second!r} is needed")


def _nonzero(table: Table, key: str, value: float) -> float:
    if value == 0 or not math.isfinite(value):
        raise table.fail(f"{key} must not be 0")
    return value
