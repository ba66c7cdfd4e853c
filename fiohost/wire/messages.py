"""What the two reports mean: a command to the bridge, and one reading of the encoder.

The magnitude of the duty crosses the wire, its sign is in the direction bits (Table 2.3 of the lab text): 1 0 forward,
0 1 reverse, 1 1 brake, 0 0 standby. The lab's own host function (Fig. 2.12) sends a NEGATIVE duty in reverse; the
target truncates it into a compare value that nobody defined, so that is not copied here.
"""

from __future__ import annotations

import struct
from operator import itemgetter
from typing import Final, NamedTuple

from fiohost.errors import LimitError, ReportError
from fiohost.wire.layout import Layout

STANDBY: Final = 0
DRIVE: Final = 1
BRAKE: Final = 2
MODE_NAMES: Final = {DRIVE: "drive", BRAKE: "brake", STANDBY: "standby"}

COMMAND_FIELDS: Final = ("duty_pct", "c3", "c4")
TELEMETRY_FIELDS: Final = ("direction", "pos")

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
    """One reading: the decoder's direction bit (0 up, 1 down; that of the last edge, stale at rest) and the count."""

    direction: int
    pos: int


class Codec:
    """Commands to bytes and bytes to telemetry, for one pair of layouts.

    *counts_per_rev* bounds POS: a count beyond it means that the layout or the encoder setting is another.
    """

    def __init__(self, command: Layout, telemetry: Layout, counts_per_rev: int) -> None:
        self.command_layout = command
        self.telemetry_layout = telemetry
        self.counts_per_rev = counts_per_rev
        self._pack = command.packer.pack
        # itemgetter gives a tuple in the order of the bytes; the magnitude stands first in what it picks from
        self._pick_command = itemgetter(*(COMMAND_FIELDS.index(name) for name in command.names))
        self._unpack = telemetry.packer.unpack
        self._pick_telemetry = itemgetter(*(telemetry.names.index(name) for name in TELEMETRY_FIELDS))
        self._length = telemetry.length

    def encode(self, command: Command) -> bytes:
        """Bytes of a command, to be sent as one report."""
        return self._pack(*self._pick_command((abs(command.duty_pct), command.c3, command.c4)))

    def decode(self, report: bytes) -> Telemetry:
        """The reading in a report. Raises ReportError where it cannot be one."""
        if len(report) != self._length:
            self.telemetry_layout.decode(report)
        direction, pos = self._pick_telemetry(self._unpack(report))
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
        return Telemetry(direction, pos)
