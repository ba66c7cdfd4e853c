"""What the two reports mean: a command to the bridge, and one reading of the encoder.

The magnitude of the duty crosses the wire, its sign is in the direction bits (Table 2.3 of the lab text): 1 0 forward,
0 1 reverse, 1 1 brake, 0 0 standby. The lab's own host function (Fig. 2.12) sends a NEGATIVE duty in reverse; the
target truncates it into a compare value that nobody defined, so that is not copied here.
"""

from __future__ import annotations

import struct
from operator import itemgetter
from typing import Final, NamedTuple

from fiohost.errors import ConfigError, LimitError, ReportError
from fiohost.wire.layout import Layout

STANDBY: Final = 0
DRIVE: Final = 1
BRAKE: Final = 2
MODE_NAMES: Final = {DRIVE: "drive", BRAKE: "brake", STANDBY: "standby"}

COMMAND_FIELDS: Final = ("duty_pct", "c3", "c4")  # that a layout must have
TELEMETRY_FIELDS: Final = ("direction", "pos")
NUMBERED_COMMAND_FIELDS: Final = (*COMMAND_FIELDS, "sequence")  # that it may have
NUMBERED_TELEMETRY_FIELDS: Final = (*TELEMETRY_FIELDS, "sequence", "tick")
MAY_BE_SCALED: Final = ("duty_pct", "tick")

_F32 = struct.Struct("<f")


class Command(NamedTuple):
    """What the bridge is told: the signed duty in percent of full scale as the wire carries it, and the mode."""

    duty_pct: float
    mode: int
    c3: int
    c4: int

    @classmethod
    def drive(cls, duty_pct: float) -> Command:
        """Drive with a signed duty; 0 brakes, as the lab's host does. Raises LimitError beyond +-100 and for NaN.

        The duty is rounded to the 32-bit float of the wire, so that the log holds what the board was told.
        """
        if not -100.0 <= duty_pct <= 100.0:  # NaN fails this too
            raise LimitError(f"a duty of {duty_pct:g} % cannot be sent: the range is -100 to 100 % of full scale")
        duty_pct = _F32.unpack(_F32.pack(duty_pct))[0]
        if duty_pct > 0.0:
            return cls(duty_pct, DRIVE, 1, 0)
        if duty_pct < 0.0:
            return cls(duty_pct, DRIVE, 0, 1)
        return BRAKE_COMMAND

    @property
    def mode_name(self) -> str:
        return MODE_NAMES[self.mode]


BRAKE_COMMAND: Final = Command(0.0, BRAKE, 1, 1)
STANDBY_COMMAND: Final = Command(0.0, STANDBY, 0, 0)


class Telemetry(NamedTuple):
    """One reading: the decoder's direction bit (0 up, 1 down; that of the last edge, stale at rest) and the count.

    *sequence* and *tick* as the report carries them, None where its layout has none.
    """

    direction: int
    pos: int
    sequence: int | None = None
    tick: float | None = None


_new = tuple.__new__  # of a Telemetry: what stands between a reading and its answer is kept short


class Codec:
    """Commands to bytes and bytes to telemetry, for one pair of layouts.

    *counts_per_rev* bounds POS: a count beyond it means that the layout or the encoder setting is another. Raises
    ConfigError for layouts that are sound as such but cannot carry these messages.
    """

    def __init__(self, command: Layout, telemetry: Layout, counts_per_rev: int) -> None:
        self.command_layout = command
        self.telemetry_layout = telemetry
        self.counts_per_rev = counts_per_rev
        for layout in (command, telemetry):
            _check_fields(layout)
        self._pack = command.pack
        # itemgetter gives a tuple in the order of the bytes; the magnitude stands first in what it picks from
        self._pick_command = itemgetter(*(NUMBERED_COMMAND_FIELDS.index(name) for name in command.names))
        self._unpack = telemetry.unpack
        places = {name: place for place, name in enumerate(telemetry.names)}
        self._numbered = len(places) > len(TELEMETRY_FIELDS)
        # what a layout lacks is picked from a None behind the values
        self._pick_telemetry = itemgetter(*(places.get(name, len(places)) for name in NUMBERED_TELEMETRY_FIELDS))
        self._pick_reading = itemgetter(*(places[name] for name in TELEMETRY_FIELDS))
        duty, sequence = command.field("duty_pct"), command.field("sequence")
        self._rounds_duty = duty is not None and (duty.is_whole or duty.scale != 1.0)
        self.command_numbers = 1 << 8 * sequence.size if sequence is not None else 1
        try:
            self.encode(Command(100.0, DRIVE, 1, 0))
        except (struct.error, OverflowError) as exc:
            raise ConfigError(f"{command.name}: the report cannot carry a duty of 100 %: {exc}") from exc

    def encode(self, command: Command, sequence: int = 0) -> bytes:
        """Bytes of a command, to be sent as one report."""
        return self._pack(*self._pick_command((abs(command.duty_pct), command.c3, command.c4, sequence)))

    def carried(self, command: Command) -> Command:
        """The command as the board will read it: a field of whole numbers rounds the duty."""
        if not self._rounds_duty or command.mode != DRIVE:
            return command
        magnitude = float(self.command_layout.decode(self.encode(command))["duty_pct"])
        return command._replace(duty_pct=magnitude if command.c3 else -magnitude)

    def decode(self, report: bytes) -> Telemetry:
        """The reading in a report. Raises ReportError where it cannot be one."""
        values = self._unpack(report)
        direction, pos = self._pick_reading(values)
        if not 0 <= pos < self.counts_per_rev:
            raise ReportError(
                f"the board reports POS = {pos}, beyond the {self.counts_per_rev} counts of a turn: "
                "its layout or encoder setting is not that of the target profile"
            )
        if direction not in (0, 1):
            raise ReportError(
                f"the board reports direction = {direction}, which is neither 0 nor 1: "
                "its layout is not that of the target profile"
            )
        if self._numbered:
            return Telemetry(*self._pick_telemetry((*values, None)))
        return _new(Telemetry, (direction, pos, None, None))


def _check_fields(layout: Layout) -> None:
    """Refuse types that a meaning cannot have: only the duty may be a fraction, only duty and tick have a scale."""
    for field in layout.fields:
        if field.name != "duty_pct" and not field.is_whole:
            raise ConfigError(f"{layout.name}: field {field.name!r} is a whole number, type {field.type!r} is not")
        if field.name in ("sequence", "tick") and not field.type.startswith("u"):
            raise ConfigError(f"{layout.name}: field {field.name!r} counts up and wraps: its type is u8, u16 or u32")
        if field.scale != 1.0 and field.name not in MAY_BE_SCALED:
            names = " and ".join(MAY_BE_SCALED)
            raise ConfigError(f"{layout.name}: field {field.name!r} has a scale; only {names} may")
