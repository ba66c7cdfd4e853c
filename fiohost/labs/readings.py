"""Readings of meters at a motor: the tables of the text's characterisation, from a TOML or CSV file or from a bench.

Seven kinds of rows: ``stall`` (voltage, current), ``lift`` (torque or mass on the spool, current, speed), ``no_load``
(voltage, speed, current), ``time_constant`` (time to 63.2 % of the speed), ``run_down`` (time to 37 % of it with the
input off), ``inductance`` (of a meter, or the time constant of the stalled winding with a known resistor in series) and
``rise`` (current so long after a step of voltage from rest).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fiohost.bench.table import read_cells
from fiohost.errors import ConfigError
from fiohost.files import write_output
from fiohost.settings import nearest, read_toml

SCHEMA = "fiohost.characterisation/1"
PORTS = ("A", "B")
GRAVITY_M_S2 = 9.8  # the text's: 0.067 kg weighs 0.6566 N
SPOOL_RADIUS_M = 0.013575  # table D-5
METER_A, METER_V = 0.001, 0.01
MOST_ROWS = 1000
LARGEST = 1e6
# kind -> the keys that its rows may have beside port, power_pct and note
KINDS = {
    "stall": ("voltage_V", "wire_voltage_V", "current_A"),
    "lift": ("mass_kg", "torque_Nm", "spool_radius_m", "current_A", "speed_rad_s", "stalled"),
    "no_load": ("voltage_V", "wire_voltage_V", "speed_rad_s", "current_A"),
    "time_constant": ("time_s",),
    "run_down": ("time_s", "from_rad_s"),
    "inductance": ("inductance_H", "series_ohm", "time_s"),
    "rise": ("voltage_V", "time_s", "current_A"),
}
COMMON = ("port", "power_pct", "note")
Row = Mapping[str, object]


@dataclass(frozen=True)
class NoLoad:
    """A steady speed without load; the current and the power that was asked for are None where nobody wrote them."""

    voltage_V: float
    speed_rad_s: float
    current_A: float | None
    power_pct: float | None = None

    def power(self, supply_V: float) -> float:
        """The power in percent: what was asked for, or else what of the supply the winding got."""
        return 100.0 * self.voltage_V / supply_V if self.power_pct is None else self.power_pct


@dataclass
class Readings:
    """All readings of one port. Voltages are the armature's; torques of a lift oppose the motor."""

    port: str = "A"
    supply_V: float = 4.5
    source: str = ""
    meter_A: float = METER_A  # one step of the meters: what is read is no better
    meter_V: float = METER_V
    stall: list[tuple[float, float]] = field(default_factory=list)  # V, A
    lift: list[tuple[float, float]] = field(default_factory=list)  # N m, A; turning
    lift_speed: list[tuple[float, float, float]] = field(default_factory=list)  # N m, A, rad/s: lifts with a speed
    lift_stalled: list[tuple[float, float]] = field(default_factory=list)
    no_load: list[NoLoad] = field(default_factory=list)
    time_constants_s: list[float] = field(default_factory=list)
    run_down: list[tuple[float, float | None]] = field(default_factory=list)  # s to 37 %, from rad/s
    inductance_H: list[float] = field(default_factory=list)  # by a meter
    decay: list[tuple[float, float]] = field(default_factory=list)  # ohm in series, s: La / (R + Ra)
    rise: list[tuple[float, float, float]] = field(default_factory=list)  # V, s after the step, A
    run_down_curve: tuple[Sequence[float], Sequence[float]] = ((), ())  # s, rad/s; of a bench's log, not of a file

    @classmethod
    def load(cls, path: Path, port: str = "A") -> Readings:
        """Read a ``.toml`` (``fiohost.characterisation/1``) or a CSV with a column ``kind``; rows of another port are
        left out. Raises ConfigError or LogError.
        """
        check_port(port)
        if path.suffix == ".toml":
            return cls._of_toml(path, port)
        found = cls(port=port, source=str(path))
        rows, _ = read_cells(path, MOST_ROWS)
        known = {"kind", *COMMON, *(key for keys in KINDS.values() for key in keys)}
        for key in rows[0]:
            if key not in known:
                raise ConfigError(f"{path}: unknown column {key!r}; {nearest(key, known)}")
        for i, row in enumerate(rows):
            kind = row.get("kind", "").strip()
            if kind not in KINDS:
                raise ConfigError(f"{path} row {i + 1}: kind = {kind[:40]!r} is unknown; {nearest(kind, KINDS)}")
            filled = {key: text for key, text in row.items() if key != "kind" and text.strip()}
            found._add(kind, filled, f"{path} row {i + 1}")
        return found

    @classmethod
    def _of_toml(cls, path: Path, port: str) -> Readings:
        top = read_toml(path)
        top.schema(SCHEMA)
        found = cls(port=port, supply_V=top.number("supply_V", 4.5, low=0.1, high=1000.0),
                    source=top.text("source", str(path)), meter_A=top.number("meter_A", METER_A, low=0.0, high=10.0),
                    meter_V=top.number("meter_V", METER_V, low=0.0, high=100.0))  # fmt: skip
        radius = top.number("spool_radius_m", SPOOL_RADIUS_M, low=1e-4, high=10.0)
        for kind in KINDS:
            rows = top.raw(kind, [])
            if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
                raise top.fail(f"{kind} is not a list of tables [[{kind}]] or {{...}}")
            if len(rows) > MOST_ROWS:
                raise top.fail(f"{kind} has more than {MOST_ROWS} rows")
            for i, row in enumerate(rows):
                found._add(kind, row, f"{path} [[{kind}]] {i + 1}", radius)
        top.finish()
        return found

    def _add(self, kind: str, row: Row, where: str, spool_radius_m: float = SPOOL_RADIUS_M) -> None:
        """Take one row in, if it belongs to this port. Raises ConfigError."""
        known = {*KINDS[kind], *COMMON}
        for key in row:
            if key not in known:
                raise ConfigError(f"{where}: unknown key {key!r} in a row of {kind}; {nearest(key, known)}")
        port = str(row.get("port", self.port)).strip()
        check_port(port, where)
        if port != self.port:
            return
        cells = _Cells(row, where)
        if kind == "stall":
            self.stall.append((_voltage(cells), cells.need("current_A")))
        elif kind == "lift":
            place = self.lift_stalled if _flag(row.get("stalled", False), where) else self.lift
            lifted = (_torque(cells, spool_radius_m), cells.need("current_A"))
            place.append(lifted)
            speed = cells.number("speed_rad_s")
            if speed is not None and place is self.lift:
                self.lift_speed.append((*lifted, speed))
        elif kind == "no_load":
            numbers = cells.need("speed_rad_s"), cells.number("current_A"), cells.number("power_pct")
            self.no_load.append(NoLoad(_voltage(cells), *numbers))
        elif kind == "time_constant":
            self.time_constants_s.append(cells.need("time_s", above=0.0))
        elif kind == "rise":
            self.rise.append((cells.need("voltage_V"), cells.need("time_s", above=0.0), cells.need("current_A")))
        elif kind == "inductance":
            if cells.number("inductance_H") is not None:
                self.inductance_H.append(cells.need("inductance_H", above=0.0))
            else:
                self.decay.append((cells.need("series_ohm", above=-1e-12), cells.need("time_s", above=0.0)))
        else:
            self.run_down.append((cells.need("time_s", above=0.0), cells.number("from_rad_s")))

    def write(self, path: Path) -> None:
        """Write the TOML that :meth:`load` reads. Raises ConfigError."""
        source = self.source.replace("\\", "/").replace('"', "'")
        lines = [f'schema = "{SCHEMA}"', f'source = "{source}"', f"supply_V = {self.supply_V!r}"]
        lines += [f"meter_A = {self.meter_A!r}", f"meter_V = {self.meter_V!r}"]

        def rows(kind: str, keys: Sequence[str], values: Sequence[Sequence[float | None]], more: str = "") -> None:
            for row in values:
                told = ", ".join(f"{k} = {v:.7g}" for k, v in zip(keys, row, strict=False) if v is not None)
                lines.append(f'  {{ port = "{self.port}", {told}{more} }},')

        for kind, keys, values, stalled in (
            ("stall", ("voltage_V", "current_A"), self.stall, []),
            ("lift", ("torque_Nm", "current_A", "speed_rad_s"), self.lift_speed or self.lift, self.lift_stalled),
            ("no_load", ("voltage_V", "speed_rad_s", "current_A", "power_pct"),
             [(r.voltage_V, r.speed_rad_s, r.current_A, r.power_pct) for r in self.no_load], []),
            ("time_constant", ("time_s",), [(t,) for t in self.time_constants_s], []),
            ("run_down", ("time_s", "from_rad_s"), self.run_down, []),
            ("rise", ("voltage_V", "time_s", "current_A"), self.rise, []),
        ):  # fmt: skip
            lines += ["", f"{kind} = ["]
            rows(kind, keys, values)
            rows(kind, keys, stalled, ", stalled = true")
            lines.append("]")
        write_output(path, "\n".join(lines) + "\n")


def check_port(port: str, where: str = "") -> None:
    if port not in PORTS:
        raise ConfigError(f"{where + ': ' if where else ''}port {port[:40]!r} is unknown; {nearest(port, PORTS)}")


@dataclass(frozen=True)
class _Cells:
    """The numbers of one row."""

    row: Row
    where: str

    def number(self, key: str) -> float | None:
        value = self.row.get(key)
        if value is None:
            return None
        try:
            found = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            found = math.nan
        if not abs(found) <= LARGEST:
            raise ConfigError(f"{self.where}: {key} = {str(value)[:40]!r} is not a number within +-{LARGEST:g}")
        return found

    def need(self, key: str, above: float = -math.inf) -> float:
        found = self.number(key)
        if found is None:
            raise ConfigError(f"{self.where}: {key} is missing")
        if not found > above:
            raise ConfigError(f"{self.where}: {key} = {found:g} is not above {above:g}")
        return found


def _voltage(cells: _Cells) -> float:
    """The armature's voltage: as given, or half of that between the two wires (the text's Eq. D-1)."""
    own, wires = cells.number("voltage_V"), cells.number("wire_voltage_V")
    if (own is None) == (wires is None):
        raise ConfigError(f"{cells.where}: give voltage_V (the armature's) or wire_voltage_V (halved), one of them")
    return own if own is not None else 0.5 * float(wires or 0.0)


def _torque(cells: _Cells, spool_radius_m: float) -> float:
    own, mass = cells.number("torque_Nm"), cells.number("mass_kg")
    if (own is None) == (mass is None):
        raise ConfigError(f"{cells.where}: give torque_Nm or mass_kg, one of them")
    radius = cells.number("spool_radius_m")
    return (
        own if own is not None else float(mass or 0.0) * GRAVITY_M_S2 * (spool_radius_m if radius is None else radius)
    )


def _flag(value: object, where: str) -> bool:
    if isinstance(value, bool):
        return value
    text = str(value).strip().lower()
    if text not in ("true", "false", "1", "0"):
        raise ConfigError(f"{where}: stalled = {text[:40]!r} is not true or false")
    return text in ("true", "1")
