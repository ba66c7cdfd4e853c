"""The layouts that the board can speak, each with the habits of its parser, in code of the board's own.

``assumed``: the plain 64-byte HID report. ``documented``: the serial packet of generated target code, 7E 7E, the ports
packed, 03 03. ``framed`` and ``framed-hid``: A5 5A, a sequence number, in telemetry the tick, a CRC-16 (polynomial
1021, initial FFFF, not reflected); the second is padded with zeros to 64 bytes. All little-endian.
"""

from __future__ import annotations

import struct
from typing import Protocol

from firmware_model.errors import FirmwareModelError
from firmware_model.report import PERIOD, Command, compare_value, parse, telemetry

BUFFER = 256  # bytes that the receiver's ring holds; what comes beyond them is lost


class Format(Protocol):
    """A layout: sizes of both reports, what a command begins with, and the two conversions."""

    out_size: int
    in_size: int
    start: bytes

    def parse(self, report: bytes) -> Command | None:
        """The command, or None where the parser drops the report: the outputs then hold."""

    def telemetry(self, direction: int, pos: int) -> bytes:
        """The report of one task step."""

    def reset(self) -> None:
        """The controller starts anew."""


class Plain:
    """The assumed layout."""

    out_size = in_size = 64
    start = b""
    telemetry = staticmethod(telemetry)

    def __init__(self, period: int = PERIOD) -> None:
        self._period = period

    def parse(self, report: bytes) -> Command | None:
        return parse(report, self._period)

    def reset(self) -> None: ...


class Documented:
    """Header, ports, terminator; neither length nor checksum, so that any packet of the right form is believed."""

    out_size, in_size = 10, 7
    start = b"\x7e\x7e"

    def __init__(self, period: int = PERIOD) -> None:
        self._period = period

    def parse(self, report: bytes) -> Command | None:
        if len(report) != self.out_size or report[:2] != self.start or report[-2:] != b"\x03\x03":
            return None
        duty_pct, c3, c4 = struct.unpack_from("<fBB", report, 2)
        return Command(compare_value(duty_pct, self._period), int(c3 != 0), int(c4 != 0))

    def telemetry(self, direction: int, pos: int) -> bytes:
        return self.start + struct.pack("<BH", direction, pos) + b"\x03\x03"

    def reset(self) -> None: ...


class Framed:
    """Numbered and checked: what no host can mean (a duty outside 0 to 100, bits other than 0 and 1) is dropped too.

    *size* pads both reports with zeros; 0 leaves them as short as they are.
    """

    start = b"\xa5\x5a"

    def __init__(self, size: int = 0, period: int = PERIOD) -> None:
        self._period = period
        self.out_size, self.in_size = max(size, 12), max(size, 13)
        self._tick = 0

    def parse(self, report: bytes) -> Command | None:
        if len(report) != self.out_size or report[:2] != self.start:
            return None
        _, duty_pct, c3, c4, crc = struct.unpack_from("<HfBBH", report, 2)
        if crc != crc16(report[:10]) or not 0.0 <= duty_pct <= 100.0 or c3 > 1 or c4 > 1:
            return None
        return Command(compare_value(duty_pct, self._period), c3, c4)

    def telemetry(self, direction: int, pos: int) -> bytes:
        body = self.start + struct.pack("<HIBH", self._tick & 0xFFFF, self._tick & 0xFFFFFFFF, direction, pos)
        self._tick += 1  # a report in each step, so that one counter serves both
        return (body + struct.pack("<H", crc16(body))).ljust(self.in_size, b"\0")

    def reset(self) -> None:
        self._tick = 0


def crc16(data: bytes) -> int:
    """Bit by bit, as small targets do it."""
    value = 0xFFFF
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


NAMES = ("assumed", "documented", "framed", "framed-hid")


def make_format(name: str, period: int = PERIOD) -> Format:
    """A layout of one board. *period*: timer ticks of a PWM period. Raises FirmwareModelError for an unknown name."""
    if name == "assumed":
        return Plain(period)
    if name == "documented":
        return Documented(period)
    if name in ("framed", "framed-hid"):
        return Framed(64 if name == "framed-hid" else 0, period)
    raise FirmwareModelError(f"the board speaks no layout {name!r}; known: {', '.join(NAMES)}")


class Receiver:
    """The receiving end of a serial line: bytes come in at any time, one packet a task step is taken out.

    As the real one's it collects a packet once it has seen the start, and drops all of it if it is not one.
    """

    def __init__(self, form: Format) -> None:
        self._form = form
        self._ring = bytearray()

    def feed(self, data: bytes) -> None:
        """Bytes from the line; what the ring cannot hold is lost."""
        self._ring += data[: BUFFER - len(self._ring)]

    def take(self) -> bytes | None:
        """The next packet that the parser does not drop, or None."""
        ring, form = self._ring, self._form
        while True:
            begins = ring.find(form.start)
            if begins < 0:
                del ring[: len(ring) - len(form.start) + 1]
                return None
            del ring[:begins]
            if len(ring) < form.out_size:
                return None
            packet = bytes(ring[: form.out_size])
            del ring[: form.out_size]
            if form.parse(packet) is not None:
                return packet
