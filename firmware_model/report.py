"""The target's own report parser and telemetry, with its habits. Layout "assumed" (the vendor's is not public).

OUT, 64 bytes: f32 duty at 0, u8 C3 at 4, u8 C4 at 5. IN, 64 bytes: u8 direction at 0, u16 POS at 1. Little-endian,
packed.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

SIZE = 64
PERIOD = 3600  # timer ticks of one 20 kHz PWM period at 72 MHz
REGISTER_TOP = 0xFFFF
_OUT = struct.Struct("<fBB")
_IN = struct.Struct("<BH61x")


class Command(NamedTuple):
    """What the outputs do: the timer's compare value and the two direction pins."""

    compare: int
    c3: int
    c4: int


def compare_value(duty_pct: float, period: int = PERIOD) -> int:
    """trunc(36 duty) as the 16-bit register takes it: unclamped above 100 (stays on); negative and NaN give 0.

    *period*: timer ticks of a PWM period, where they are not 3600.
    """
    if not duty_pct > 0.0:
        return 0
    scaled = period / 100.0 * duty_pct
    return REGISTER_TOP if math.isinf(scaled) or scaled >= REGISTER_TOP else int(scaled)


def parse(report: bytes, period: int = PERIOD) -> Command | None:
    """The command in a report, or None where the parser drops it (wrong length): the outputs then hold."""
    if len(report) != SIZE:
        return None
    duty_pct, c3, c4 = _OUT.unpack_from(report)
    return Command(compare_value(duty_pct, period), int(c3 != 0), int(c4 != 0))


def telemetry(direction: int, pos: int) -> bytes:
    """One IN report: DIR (1 counting down) first, then POS."""
    return _IN.pack(direction, pos)
