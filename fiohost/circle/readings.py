"""From a readings file (schema ``fiohost.readings/1``) to a table as evidence, and from such files to a diagnosis."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fiohost.bench.table import read_cells
from fiohost.control.closed_loop import Loop
from fiohost.discover.tables.diagnose import TableDiagnosis, diagnose_tables
from fiohost.discover.tables.responses import RESPONSE_FIGURES, Response, Responses
from fiohost.discover.tables.steady import CONSTANTS, Point, SteadyReadings, with_values
from fiohost.discover.tables.table import Figure, Row, Table
from fiohost.errors import ConfigError, DataError
from fiohost.motor.model import Model
from fiohost.settings import Table as Toml
from fiohost.settings import nearest, read_text, read_toml

SCHEMA = "fiohost.readings/1"
MOST = 1e9  # of any reading: beyond it squares and sums lose their sense
COMMON = ("title", "source", "table", "row", "only", "figures")
KINDS = {
    "response": ("step", "controller", "deadband", "encoder"),
    "steady": ("duty", "torque", "speed", "motor", "run"),
}
MOST_ROWS, MOST_TICKS = 500, 60_000
DEGREES = {"deg": 1.0, "rad": math.degrees(1.0)}
SPEEDS = {"deg/s": 1.0, "rad/s": math.degrees(1.0), "rpm": 6.0}
CURRENTS = {"A": 1.0, "mA": 1e-3}
TORQUES = {"N m": 1.0, "mN m": 1e-3}
GAIN_UNITS = ("pct/deg", "pct/rad", "V/deg", "V/rad")
CONTROLLERS = {"p": ("kp",), "pd": ("kp", "kd"), "pi": ("kp", "ki"), "pid": ("kp", "ki", "kd")}

Cells = Mapping[str, object]


@dataclass(frozen=True)
class _Rows:
    """The rows of a file and where they stand, for messages; ``columns`` are the names that any of them has."""

    where: str
    rows: Sequence[Cells]
    sha256: str

    @property
    def columns(self) -> list[str]:
        return list(dict.fromkeys(name for row in self.rows for name in row))

    def cell(self, index: int, column: str) -> float | None:
        """A number, or None for an empty or absent cell. Raises ConfigError for anything else."""
        value = self.rows[index].get(column, "")
        if isinstance(value, str) and not value.strip():
            return None
        try:
            number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not abs(number) <= MOST:  # NaN and infinity too
            raise ConfigError(
                f"{self.where} row {index + 1}: {column} = {str(value)[:40]!r} is not a number within {MOST:g}"
            )
        return number


class _Setting:
    """A number that is the same in all rows, or the name of the column that holds it."""

    def __init__(
        self, table: Toml, key: str, rows: _Rows, default: float | None = None, *, low: float, high: float
    ) -> None:
        self.key, self.rows, self.low, self.high, self.table = key, rows, low, high, table
        self.column: str | None = None
        self.value = 0.0
        given = table.raw(key, default)
        if isinstance(given, str):
            if given not in rows.columns:
                raise table.fail(f"{key} = {given!r} is no column of {rows.where}; {nearest(given, rows.columns)}")
            self.column = given
        else:
            self.value = table.number(key, default, low=low, high=high)

    def at(self, index: int) -> float:
        if self.column is None:
            return self.value
        value = self.rows.cell(index, self.column)
        if value is None:
            raise ConfigError(f"{self.rows.where} row {index + 1}: {self.column} is empty, which {self.key} needs")
        if not self.low <= value <= self.high:
            raise ConfigError(
                f"{self.rows.where} row {index + 1}: {self.column} = {value:g} is outside {self.low:g}..{self.high:g}"
            )
        return value


def read_readings(path: Path) -> tuple[Table, dict[str, str]]:
    """Read one file: the table, and the hashes of what it was read from. Raises ConfigError, LogError."""
    top = read_toml(path)
    top.schema(SCHEMA)
    kind = top.text("kind", choices=list(KINDS))
    for key in (*COMMON, *KINDS[kind]):
        top.raw(key)
    top.finish()
    top.text("title", "")
    top.text("source", "")
    rows = _rows(top, path)
    figures = top.table("figures", required=True)
    found: Table = (
        _responses(top, figures, rows, path.stem) if kind == "response" else _steady(top, figures, rows, path.stem)
    )
    return found, {
        "file": str(path),
        "sha256": hashlib.sha256(read_text(path).encode()).hexdigest(),
        "table_sha256": rows.sha256,
    }


def _rows(top: Toml, path: Path) -> _Rows:
    """The rows: of the table beside the file or written in it, those chosen by [only]."""
    inline = top.tables("row")
    if bool(inline) == ("table" in top):
        raise top.fail("exactly one of 'table', a CSV file beside this one, and [[row]] tables is needed")
    rows: list[Cells]
    if inline:
        rows, digest, where = [row.data for row in inline], "", str(path)
    else:
        place = path.parent / top.text("table")
        read, digest = read_cells(place, MOST_ROWS)
        rows, where = list(read), str(place)
    only = top.table("only")
    columns = list(dict.fromkeys(name for row in rows for name in row))
    for column in only.data:
        if column not in columns:
            raise only.fail(f"{column!r} is no column of {where}; {nearest(column, columns)}")
        wanted = str(only.raw(column))
        rows = [row for row in rows if str(row.get(column, "")) == wanted]
    if not 0 < len(rows) <= MOST_ROWS:
        raise top.fail(f"{len(rows)} rows of {where} are chosen; 1 to {MOST_ROWS} can be judged")
    return _Rows(where, rows, digest)


def _figure(
    figures: Toml, name: str, rows: _Rows, unit: Callable[[Toml], tuple[str, float]]
) -> tuple[Figure, str] | None:
    """One figure and its column; ``unit`` reads its unit and the size of that. None where it is not there."""
    if figures.raw(name) is None:
        return None
    table = figures.table(name)
    column = table.text("column", name)
    if column not in rows.columns:
        raise table.fail(f"column = {column!r} is no column of {rows.where}; {nearest(column, rows.columns)}")
    quantum = table.number("quantum", 0.0, low=0.0, high=1e9)
    scatter = table.number("scatter", 0.0, low=0.0, high=1e9)
    if quantum == 0.0 and scatter == 0.0:
        raise table.fail("one of quantum, the step of the printed numbers, and scatter, of repeats, is needed")
    text, scale = unit(table)
    table.finish()
    return Figure(name, text, quantum, scatter, scale), column


def _measured(rows: _Rows, figures: Sequence[tuple[Figure, str]], labels: Sequence[_Setting]) -> list[Row]:
    """Readings by row; a row's label names what changes from row to row."""
    found = []
    for i in range(len(rows.rows)):
        cells = {figure.name: rows.cell(i, column) for figure, column in figures}
        columns = list(dict.fromkeys(s.column for s in labels if s.column))
        label = ", ".join(f"{c} {rows.cell(i, c):g}" for c in columns) or f"row {i + 1}"
        found.append(Row(label, {name: value for name, value in cells.items() if value is not None}))
        if not found[-1].measured:
            raise ConfigError(f"{rows.where} row {i + 1}: none of the figures is there")
    return found


def _all_figures(
    figures: Toml, known: Sequence[str], rows: _Rows, unit: Callable[[Toml, str], tuple[str, float]]
) -> list[tuple[Figure, str]]:
    found = [_figure(figures, name, rows, lambda table, name=name: unit(table, name)) for name in known]  # type: ignore[misc]
    figures.finish()
    chosen = [f for f in found if f is not None]
    if not chosen:
        raise figures.fail(f"no figure is given; known: {', '.join(known)}")
    return chosen


def _responses(top: Toml, figures: Toml, rows: _Rows, name: str) -> Responses:
    step, controller = top.table("step", required=True), top.table("controller", required=True)
    deadband, encoder = top.table("deadband"), top.table("encoder")
    unit = step.text("unit", "deg")
    if unit not in DEGREES and "deg_per_unit" not in step:
        raise step.fail(f"unit = {unit!r} needs deg_per_unit, the degrees of the shaft that make one of it")
    size = step.number("deg_per_unit", DEGREES.get(unit), low=1e-9, high=1e9)
    to = _Setting(step, "to", rows, low=-1e6, high=1e6)
    begin = _Setting(step, "from", rows, 0.0, low=-1e6, high=1e6)
    hold_s = step.number("hold_s", 0.0, low=0.0, high=60.0)
    duration_s = step.number("duration_s", 3.0, low=0.05, high=60.0)
    times_of_target = step.text("times_of", "final", choices=("final", "target")) == "target"
    step.finish()

    kind = controller.text("kind", "p", choices=list(CONTROLLERS))
    gain_unit = controller.text("unit", "pct/deg", choices=GAIN_UNITS)
    gains = {key: _Setting(controller, key, rows, low=-1e6, high=1e6) for key in CONTROLLERS[kind]}
    per_error = 1.0 / DEGREES[gain_unit.partition("/")[2]]
    if gain_unit.startswith("V"):
        per_error *= 100.0 / controller.number("full_scale_V", low=1e-3, high=1e4)
    limit = _Setting(controller, "limit_pct", rows, 100.0, low=0.1, high=100.0)
    sample_time_s = controller.number("sample_time_s", 0.005, low=1e-4, high=0.5)
    delay_s = controller.number("delay_s", 0.0, low=0.0, high=1.0)
    filter_s = controller.number("filter_s", 0.0, low=0.0, high=100.0)
    on_angle = controller.text("derivative_on", "error", choices=("error", "angle")) == "angle"
    holds = controller.flag("holds_integral", False)
    controller.finish()
    band = {key: deadband.number(key, 0.0, low=low, high=high) for key, low, high in DEADBAND}
    deadband.finish()
    quantum_deg = encoder.number("quantum_deg", 0.0, low=0.0, high=360.0)
    encoder.finish()
    if (hold_s + duration_s) / sample_time_s > MOST_TICKS:
        raise step.fail(f"a run of {hold_s + duration_s:g} s at {sample_time_s:g} s has more than {MOST_TICKS} ticks")

    chosen = _all_figures(
        figures, list(RESPONSE_FIGURES), rows, lambda table, figure: _response_unit(figure, unit, size)
    )
    responses = []
    for i in range(len(rows.rows)):
        gain = {key: per_error * setting.at(i) for key, setting in gains.items()}
        loop = Loop(
            gain["kp"], gain.get("ki", 0.0), gain.get("kd", 0.0), filter_s, on_angle, holds, limit.at(i), **band,
            sample_time_s=sample_time_s, delay_s=delay_s,
        )  # fmt: skip
        target, start = size * to.at(i), size * begin.at(i)
        if target == start:
            raise ConfigError(f"{rows.where} row {i + 1}: its step goes nowhere, from and to are the same")
        responses.append(Response(loop, target, start, hold_s, duration_s))
    labels = [*gains.values(), limit, to, begin]
    smallest = min(abs(r.to_deg - r.from_deg) for r in responses)
    counted = [_counted(f, quantum_deg, smallest) for f, _ in chosen]
    measured = _measured(rows, chosen, labels)
    return Responses(name, counted, measured, responses, times_of_target=times_of_target)


def _counted(figure: Figure, quantum_deg: float, step_deg: float) -> Figure:
    """A figure with what an encoder's counts add to its scatter.

    The loop itself is simulated without counts: its figures would be stairs over every parameter, which no fit climbs.
    """
    lengths = {"overshoot_pct": step_deg / 100.0, "final": figure.scale, "steady_state_error": figure.scale}
    if figure.name not in lengths:
        return figure
    counts = quantum_deg / lengths[figure.name] / math.sqrt(12.0)
    return replace(figure, scatter=math.hypot(figure.scatter, counts))


DEADBAND = (("u_plus_pct", 0.0, 99.0), ("u_minus_pct", -99.0, 0.0), ("threshold_pct", 0.0, 100.0))


def _response_unit(figure: str, unit: str, size: float) -> tuple[str, float]:
    """A figure's unit and its size: seconds and percent as they are, lengths in the step's."""
    own = RESPONSE_FIGURES[figure]
    return (own, 1.0) if own else (unit, size)


def _steady(top: Toml, figures: Toml, rows: _Rows, name: str) -> SteadyReadings:
    duty, duty_scale = _given(top, "duty", rows, {"pct": 1.0, "V": math.nan}, 100.0)
    torque, torque_scale = _given(top, "torque", rows, TORQUES, 1e6)
    speed, speed_scale = _given(top, "speed", rows, SPEEDS, 1e7)
    if duty is None and speed is None:
        raise top.fail("one of [duty] and [speed] is needed to say where the motor ran")
    motor, timing = top.table("motor"), top.table("run")
    fitted = motor.raw("fit", [])
    names = [c.name for c in CONSTANTS]
    if not isinstance(fitted, list) or not all(isinstance(n, str) for n in fitted):
        raise motor.fail("fit is not a list of names")
    for one in fitted:
        if one not in names:
            raise motor.fail(f"fit names {one!r}, which is unknown; {nearest(one, names)}")
    given = {c.name: motor.number(c.name, low=c.lower, high=c.upper) for c in CONSTANTS if c.name in motor}
    motor.finish()
    settle_s = timing.number("settle_s", 2.0, low=0.05, high=600.0)
    average_s = timing.number("average_s", 1.0, low=0.05, high=600.0)
    timing.finish()

    def unit(table: Toml, figure: str) -> tuple[str, float]:
        known = SPEEDS if figure == "speed" else CURRENTS
        text = table.text("unit", next(iter(known)), choices=list(known))
        return text, known[text]

    chosen = _all_figures(figures, ("speed", "current"), rows, unit)
    needed = {"stall_current_A": any(f.name == "current" for f, _ in chosen), "stall_torque_Nm": torque is not None}
    for one, need in needed.items():
        if need and one not in given and one not in fitted:
            raise motor.fail(f"{one} is needed to predict these readings: give it, or name it in fit")
    if speed is not None and any(f.name == "speed" for f, _ in chosen):
        raise top.fail("speed is both given and measured; take one of [speed] and [figures.speed] out")
    points = []
    for i in range(len(rows.rows)):
        duty_pct = None if duty is None else duty.at(i) * duty_scale
        if duty_pct is not None and abs(duty_pct) > 100.0 + 1e-6:
            raise ConfigError(f"{rows.where} row {i + 1}: a duty of {duty_pct:g} % is beyond full scale")
        points.append(
            Point(
                duty_pct,
                0.0 if torque is None else torque.at(i) * torque_scale,
                None if speed is None else speed.at(i) * speed_scale,
            )
        )
    labels = [setting for setting in (duty, torque, speed) if setting is not None]
    constants = with_values(CONSTANTS, given, fitted)
    measured = _measured(rows, chosen, labels)
    return SteadyReadings(name, [f for f, _ in chosen], measured, points, constants, settle_s, average_s)


def _given(top: Toml, key: str, rows: _Rows, units: Mapping[str, float], high: float) -> tuple[_Setting | None, float]:
    """What a row is given of one quantity, and the size of its unit; None where it is not."""
    if key not in top:
        return None, 1.0
    table = top.table(key)
    unit = table.text("unit", next(iter(units)), choices=list(units))
    scale = units[unit]
    if math.isnan(scale):
        scale = 100.0 / table.number("full_scale_V", low=1e-3, high=1e4)
    setting = _Setting(table, "value", rows, low=-high, high=high)
    table.finish()
    return setting, scale


def diagnose_readings(
    paths: Sequence[str | Path],
    model: str | Model = "linear",
    *,
    library: Sequence[str] | None = None,
    seed: int = 0,
    say: Callable[[str], None] = lambda text: None,
    announce: Callable[[Sequence[Table]], None] = lambda tables: None,
) -> TableDiagnosis:
    """Name what a declared model lacks, from readings files, all together. Raises FiohostError."""
    declared = model if isinstance(model, Model) else Model.parse(str(model))
    files: dict[str, dict[str, str]] = {}
    tables: list[Table] = []
    for path in [Path(p) for p in paths]:
        table, said = read_readings(path)
        if table.name in files:
            raise DataError(f"two readings files are named {table.name}; give each once, by a name of its own")
        files[table.name] = said
        tables.append(table)
    announce(tables)
    from_file = not isinstance(model, str) or model.endswith(".toml")
    return diagnose_tables(tables, declared, library=library, from_file=from_file, seed=seed, say=say, files=files)
