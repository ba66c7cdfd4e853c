"""The ATmega328P of an Arduino Uno, run by simavr through a small C file built on this machine when first used.

simavr (GPL) is no part of this package: where it is not installed there is no emulated Uno, and the error says what to
install.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from firmware_model.compiled import kept_in
from firmware_model.emulated.chip import HIGH, LOW, Level
from firmware_model.emulated.hexfile import read_hex
from firmware_model.errors import FirmwareModelError
from firmware_model.quadrature import Edge

SOURCE = Path(__file__).with_name("simavr.c")
INSTALL = "apt-get install gcc libc6-dev libsimavr-dev libelf-dev"
HERTZ = 16e6
BAUD = 500_000
BITS = 10  # of a byte on the line: start, eight, stop
# data addresses (datasheet, register summary)
PORTB, DDRB, TCCR1A, TCCR1B, ICR1, OCR1A, OCR1B = 0x25, 0x24, 0x80, 0x81, 0x86, 0x88, 0x8A
UCSR0A, UBRR0 = 0xC0, 0xC4
U2X, WGM11, WGM12, WGM13 = 0x02, 0x02, 0x08, 0x10
STATS = ("task_cycles", "dark_cycles", "bytes_overrun", "tasks", "instructions")


@cache
def library() -> Any:
    """The emulator as a library. Raises FirmwareModelError where it cannot be built here."""
    name = f"simavr-{hashlib.blake2s(SOURCE.read_bytes(), digest_size=8).hexdigest()}.so"
    kept = kept_in()
    path = Path(kept) / name if kept else Path(tempfile.mkdtemp()) / name
    if not path.is_file():
        compiler = shutil.which("cc") or shutil.which("gcc")
        if compiler is None:
            raise FirmwareModelError(f"the emulated Uno needs a C compiler and simavr: {INSTALL}")
        half = path.with_suffix(f".{os.getpid()}")
        command = [compiler, "-shared", "-fPIC", "-O2", "-o", str(half), str(SOURCE), "-lsimavr", "-lelf"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            why = next((line for line in done.stderr.splitlines() if "error" in line), "the linker says no")
            raise FirmwareModelError(f"the emulated Uno cannot be built here ({why[:120]}): {INSTALL}")
        half.replace(path)
    try:
        loaded = ctypes.CDLL(str(path))
    except OSError as exc:
        raise FirmwareModelError(f"the emulated Uno cannot be loaded ({exc}): {INSTALL}") from exc
    handle, u32, u64 = ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint64
    for function, result, arguments in (
        ("new", handle, [ctypes.c_char_p, u32]),
        ("free", None, [handle]),
        ("run", u64, [handle, u64]),
        ("edges", None, [handle, ctypes.POINTER(u64), ctypes.c_char_p, ctypes.c_int]),
        ("send", None, [handle, ctypes.c_char_p, ctypes.c_int, u32]),
        ("sent", ctypes.c_int, [handle, ctypes.c_char_p]),
        ("peek", ctypes.c_uint8, [handle, ctypes.c_uint16]),
        ("cycle", u64, [handle]),
        ("stats", None, [handle, ctypes.POINTER(u64), ctypes.c_int]),
    ):
        call = getattr(loaded, f"avr_lines_{function}")
        call.restype, call.argtypes = result, arguments
    return loaded


class Atmega328p:
    """One chip with the program of a .hex file. Its serial line runs at *baud* on the host's side."""

    hertz = HERTZ

    def __init__(self, image: Path, baud: int = BAUD) -> None:
        code = read_hex(image)
        self._library = library()
        self._handle = self._library.avr_lines_new(code, len(code))
        if not self._handle:
            raise FirmwareModelError("simavr knows no atmega328p here")
        self._baud = baud
        self._out = ctypes.create_string_buffer(4096)

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            self._library.avr_lines_free(self._handle)

    @property
    def cycle(self) -> int:
        return int(self._library.avr_lines_cycle(self._handle))

    @property
    def time_s(self) -> float:
        return self.cycle / HERTZ

    def run_to(self, time_s: float) -> None:
        if not self._library.avr_lines_run(self._handle, round(time_s * HERTZ)):
            raise FirmwareModelError("the program on the emulated Uno crashed")

    def output(self, pin: str) -> Level | None:
        bit = 1 << int(pin[2:])
        if not self.peek(DDRB) & bit:
            return None
        control = self.peek(TCCR1A)
        for of, shift, compare in (("PB1", 6, OCR1A), ("PB2", 4, OCR1B)):
            if pin == of and control >> shift & 3:
                return self._pulses(control >> shift & 3, compare)
        return HIGH if self.peek(PORTB) & bit else LOW

    def _pulses(self, mode: int, compare: int) -> Level:
        """A compare output: fast PWM up to ICR1, clear on match, is all that is understood here."""
        control_a, control_b = self.peek(TCCR1A), self.peek(TCCR1B)
        modes = control_b & (WGM13 | WGM12), control_a & 3, control_b & 7, mode
        if modes != (WGM13 | WGM12, WGM11, 1, 2):
            raise FirmwareModelError(f"Timer1 is in a mode that is not modelled: {control_a:02x} {control_b:02x}")
        return Level(min(self._u16(compare), self._u16(ICR1)) + 1, self._u16(ICR1) + 1)

    def put_edges(self, edges: Sequence[Edge]) -> None:
        count = len(edges)
        at = (ctypes.c_uint64 * max(count, 1))(*(round(edge.time_s * HERTZ) for edge in edges))
        self._library.avr_lines_edges(self._handle, at, bytes(edge.levels for edge in edges), count)

    def receive(self, data: bytes) -> None:
        speed = HERTZ / ((8 if self.peek(UCSR0A) & U2X else 16) * (self._u16(UBRR0) + 1))
        if abs(speed / self._baud - 1.0) > 0.02:
            raise FirmwareModelError(f"the Uno listens at {speed:.0f} Bd, the line runs at {self._baud} Bd")
        self._library.avr_lines_send(self._handle, data, len(data), round(BITS * HERTZ / self._baud))

    def sent(self) -> bytes:
        count = self._library.avr_lines_sent(self._handle, self._out)
        return self._out.raw[:count]

    def peek(self, address: int) -> int:
        """A byte of the chip's data space."""
        return int(self._library.avr_lines_peek(self._handle, address))

    def _u16(self, address: int) -> int:
        return self.peek(address) | self.peek(address + 1) << 8

    def stats(self, *, anew: bool = False) -> dict[str, int]:
        """Cycles of the longest task and of the longest time with interrupts off, bytes that came too fast, tasks and
        instructions; the first three of the time since they were asked *anew*.
        """
        values = (ctypes.c_uint64 * len(STATS))()
        self._library.avr_lines_stats(self._handle, values, int(anew))
        return dict(zip(STATS, values, strict=True))
