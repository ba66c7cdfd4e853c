"""What an emulated microcontroller offers: pins, a serial line, and time that passes when it is told to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from firmware_model.quadrature import Edge


class Level(NamedTuple):
    """What a pin puts out: high for *high* of each *period* timer ticks; a steady level is 0 or 1 of 1."""

    high: int
    period: int

    @property
    def share(self) -> float:
        return self.high / self.period


LOW, HIGH = Level(0, 1), Level(1, 1)


class Chip(Protocol):
    """One microcontroller with its program, from power-on."""

    hertz: float

    @property
    def time_s(self) -> float:
        """Time since power-on."""

    def run_to(self, time_s: float) -> None:
        """Run to that time, or to where an output changed; :attr:`time_s` says how far."""

    def output(self, pin: str) -> Level | None:
        """What the pin puts out; None where nothing drives it."""

    def put_edges(self, edges: Sequence[Edge]) -> None:
        """The encoder's levels from now on; edges given before that have not come are forgotten."""

    def receive(self, data: bytes) -> None:
        """Bytes that begin to arrive on the serial input now, behind those that are still on their way."""

    def sent(self) -> bytes:
        """Bytes that have left the serial output since the last call."""
