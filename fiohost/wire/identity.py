"""Who a board is, asked over the wire: a query of four bytes, an answer of forty (docs/protocol.md).

A board that does not know the query passes it over as garbage, so it may be put to any board of the layout
serial-framed; the answer is garbage to whoever waits for telemetry, and does not hide the report behind it.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from fiohost.wire.crc import crc_function, find_crc

_crc = crc_function(find_crc("CRC-16/CCITT-FALSE"))
QUERY_BODY = b"\xa5?"
QUERY = QUERY_BODY + struct.pack("<H", _crc(QUERY_BODY))
START = b"\xa5!"
FORMAT = 1
_ANSWER = struct.Struct("<2sB12s8sBBBHHHHHHH")
ANSWER_BYTES = _ANSWER.size


@dataclass(frozen=True)
class Identity:
    """What a board says of itself. Counts are since its reset."""

    name: str
    bridge: str
    version: str
    duty_steps: int
    watchdog_s: float  # it brakes so long after the last command; 0: never
    counts_per_rev: int
    sample_time_s: float
    refused_frames: int  # whole frames that were none
    bad_edges: int  # changes of both encoder levels at once

    def describe(self) -> str:
        guard = f"brakes {1e3 * self.watchdog_s:g} ms after the last command" if self.watchdog_s else "has no watchdog"
        return (
            f"the board is {self.name!r}, firmware {self.version}, bridge {self.bridge}: {self.duty_steps} duty steps, "
            f"{self.counts_per_rev} counts a turn, a step every {1e3 * self.sample_time_s:g} ms; it {guard}"
        )


def find_identity(data: bytes) -> Identity | None:
    """The first good answer in a piece of a stream."""
    at = data.find(START)
    while at >= 0:
        piece = data[at : at + ANSWER_BYTES]
        if len(piece) == ANSWER_BYTES:
            _, form, name, bridge, *numbers, crc = _ANSWER.unpack(piece)
            if form == FORMAT and crc == _crc(piece[:-2]):
                major, minor, patch, steps, watchdog_ms, counts, step_us, refused, bad = numbers
                return Identity(
                    _text(name), _text(bridge), f"{major}.{minor}.{patch}", steps, 1e-3 * watchdog_ms, counts,
                    1e-6 * step_us, refused, bad,
                )  # fmt: skip
        at = data.find(START, at + 1)
    return None


def _text(raw: bytes) -> str:
    return raw.rstrip(b"\0").decode("ascii", "replace")
