"""A target profile: what the host must know about a board, as data from ``configs/targets/NAME.toml``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from fiohost.errors import ConfigError
from fiohost.settings import Table, find_config, parse_toml, read_text
from fiohost.wire.layout import Layout
from fiohost.wire.messages import (
    COMMAND_FIELDS,
    NUMBERED_COMMAND_FIELDS,
    NUMBERED_TELEMETRY_FIELDS,
    TELEMETRY_FIELDS,
    Codec,
)

SCHEMA = "fiohost.target/1"
DEFAULT_PROFILE = "hid-assumed"
DEFAULT_BOARD_LAYOUT = "assumed"
DEFAULT_BAUD = 115_200
MEDIA = ("hid", "serial", "sim")
STATUSES = ("assumed", "documented", "measured")


@dataclass(frozen=True)
class Limits:
    """What a bench may do; infinite where nobody set a limit. :mod:`fiohost.bench.limits` enforces them."""

    duty_pct: float = 100.0  # no command beyond it
    slew_pct_per_s: float = math.inf  # the duty follows its command no faster
    travel_deg: float = math.inf  # the shaft from where the run began, either way
    run_time_s: float = math.inf  # of one run

    @classmethod
    def from_table(cls, table: Table) -> Limits:
        """Read a table of limits, any of which may be absent. Raises ConfigError."""
        ranges = {
            "duty_pct": (0.0, 100.0),
            "slew_pct_per_s": (0.1, 1e6),
            "travel_deg": (1.0, 1e9),
            "run_time_s": (0.05, 1e7),
        }
        found = {key: table.number(key, low=low, high=high) for key, (low, high) in ranges.items() if key in table}
        for key in ranges:
            table.raw(key)
        table.finish()
        return cls(**found)

    def within(self, other: Mapping[str, float]) -> Limits:
        """These limits, each the stricter of its own and that of *other*, a table of some. Raises ConfigError."""
        asked = Limits.from_table(Table(dict(other), "limits"))
        return Limits(*(min(getattr(self, name), getattr(asked, name)) for name in self.__dataclass_fields__))

    def describe(self) -> str:
        """Words for the log's head; empty where there is no limit but full scale."""
        units = {"duty_pct": "%", "slew_pct_per_s": "%/s", "travel_deg": "deg", "run_time_s": "s"}
        names = {name: getattr(self, name) for name in units}
        plain = Limits()
        said = [
            f"{name.split('_')[0]} {value:g} {units[name]}"
            for name, value in names.items()
            if value != getattr(plain, name)
        ]
        return ", ".join(said)


@dataclass(frozen=True)
class Guards:
    """When a bench believes that something is wrong with the motor, and brakes. :mod:`fiohost.bench.rest` and
    :mod:`fiohost.bench.guard` judge by them.
    """

    braked_deg_s: float = 60.0  # a braked shaft that a load turns no faster than this is not a running motor
    stall_s: float = 3.0  # of full duty, or as long for the same heat, while the shaft stands
    wrong_way_deg: float = 180.0  # against a strong duty, ever faster
    speed_deg_s: float = 10_000.0  # no shaft turns faster: readings that say so are wrong ones
    late_pct: float = 1.0  # of the ticks may be missed or late because of the host
    gap_s: float = 0.1  # the host's loop stood still for so long: the guardian brakes, and the run ends
    silence_s: float = 0.05  # without a good report: nobody knows what the motor does

    def changed(self, other: Mapping[str, float]) -> Guards:
        """These guards, with the values of *other* in the place of some. Raises ConfigError."""
        asked = Guards.from_table(Table(dict(other), "guards"))
        return replace(self, **{key: getattr(asked, key) for key in other})

    @classmethod
    def from_table(cls, table: Table) -> Guards:
        """Read a table of guards, any of which may be absent. Raises ConfigError."""
        found = {key: table.number(key, low=low, high=high) for key, (low, high) in _GUARDS.items() if key in table}
        for key in _GUARDS:
            table.raw(key)
        table.finish()
        return cls(**found)


_GUARDS = {
    "braked_deg_s": (0.0, 1e6),
    "gap_s": (0.02, 60.0),
    "late_pct": (0.0, 100.0),
    "silence_s": (0.01, 60.0),
    "stall_s": (0.05, 1e9),
    "wrong_way_deg": (5.0, 1e9),
    "speed_deg_s": (1.0, 1e9),
}


@dataclass(frozen=True)
class TargetProfile:
    """One board: medium, layouts, identity and limits."""

    name: str
    title: str
    transport: str
    status: str  # how well the layout is known
    sample_time_s: float
    counts_per_rev: int
    duty_steps: int  # timer counts of a PWM period, to which the target truncates the duty; 0 unknown
    vendor_id: int | None
    product_id: int | None
    limits: Limits
    codec: Codec
    board_layout: str = DEFAULT_BOARD_LAYOUT  # which one a simulated board is to speak
    text: str = ""  # of the file
    baud: int = DEFAULT_BAUD  # of a serial line; a USB port of the board's own has no use for it
    watchdog_s: float = 0.0  # the board brakes by itself after so long without a command; 0: it never does
    board: str = ""  # what it calls itself when asked; empty where nobody knows
    guards: Guards = Guards()

    @classmethod
    def load(cls, name_or_path: str | Path = DEFAULT_PROFILE) -> TargetProfile:
        """Read a profile by name or path. Raises ConfigError for unknown keys and layouts that do not fit."""
        path = find_config("targets", name_or_path)
        text = read_text(path)
        return cls._read(parse_toml(text, str(path)), path.stem, text)

    @classmethod
    def parse(cls, text: str, name: str) -> TargetProfile:
        """A profile from the text of its file, as a trace carries it. Raises ConfigError."""
        return cls._read(parse_toml(text, f"profile {name}"), name, text)

    @classmethod
    def _read(cls, top: Table, name: str, text: str) -> TargetProfile:
        top.schema(SCHEMA)
        title = top.text("title", name)
        transport = top.text("transport", choices=MEDIA)
        status = top.text("status", "assumed", choices=STATUSES)
        sample_time_s = top.number("sample_time_s", 0.005, low=1e-4, high=1.0)
        counts_per_rev = top.integer("counts_per_rev", 720, low=4, high=1 << 24)
        duty_steps = top.integer("duty_steps", 0, low=0, high=1 << 32)
        baud = top.integer("baud", DEFAULT_BAUD, low=50, high=50_000_000)
        watchdog_s = top.number("watchdog_s", 0.0, low=0.0, high=60.0)
        identity, limits = top.table("identity"), Limits.from_table(top.table("limits"))
        guards = Guards.from_table(top.table("guards"))
        command = Layout.from_table(top.table("command", required=True), NUMBERED_COMMAND_FIELDS, COMMAND_FIELDS)
        telemetry = Layout.from_table(
            top.table("telemetry", required=True), NUMBERED_TELEMETRY_FIELDS, TELEMETRY_FIELDS
        )
        board_layout = top.text("board_layout", DEFAULT_BOARD_LAYOUT) if transport == "sim" else DEFAULT_BOARD_LAYOUT
        top.finish()
        vendor_id = None if identity.raw("vendor_id") is None else identity.integer("vendor_id", low=0, high=0xFFFF)
        product_id = None if identity.raw("product_id") is None else identity.integer("product_id", low=0, high=0xFFFF)
        board = identity.text("board", "")
        identity.finish()
        if transport == "hid" and (command.report_id is None) != (telemetry.report_id is None):
            raise ConfigError(f"{name}: a HID device numbers all reports or none: give both a report_id, or neither")
        if transport == "serial":
            for layout in (command, telemetry):
                if not layout.has_marks:
                    raise ConfigError(
                        f"{layout.name}: a serial line needs a header, a terminator or a crc, or nobody can tell where "
                        "a report begins"
                    )
        codec = Codec(command, telemetry, counts_per_rev)
        return cls(
            name, title, transport, status, sample_time_s, counts_per_rev, duty_steps, vendor_id, product_id,
            limits, codec, board_layout, text, baud, watchdog_s, board, guards,
        )  # fmt: skip

    @property
    def limit_duty_pct(self) -> float:
        return self.limits.duty_pct

    def with_counts(self, counts_per_rev: int | None) -> TargetProfile:
        """The same board with another encoder setting; None changes nothing."""
        if counts_per_rev is None or counts_per_rev == self.counts_per_rev:
            return self
        codec = Codec(self.codec.command_layout, self.codec.telemetry_layout, counts_per_rev)
        return replace(self, counts_per_rev=counts_per_rev, codec=codec)
