"""What every medium offers to the bench: open, send, receive, close, and its errors.

A transport carries bytes and knows nothing of what they mean: whole reports (HID), or, where ``stream`` is set, pieces
of a stream as they come (serial). The room of the wire makes messages of both. A report with an ID has it as its first
byte, in both directions. Errors are those of :mod:`fiohost.errors`: TelemetryTimeoutError where nothing came in time,
DisconnectedError where the board went away, TransportError otherwise.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from fiohost.errors import DisconnectedError


@dataclass(frozen=True)
class Way:
    """How another process can write to an open line: by its descriptor, by a node, or by a path of a hidapi module.

    ``prefix`` goes before each report.
    """

    fd: int = -1
    path: str = ""
    module: str = ""
    prefix: bytes = b""


class Transport(ABC):
    """One line to one board.

    ``stream``: ``receive`` gives bytes without borders between reports, oldest first, none left out.
    ``lock_step``: the board does one task step for each ``receive``, whenever that is (a simulated board); otherwise
    it keeps its own time. ``facts`` are metadata for the log, none of which says what is in a sealed board.
    """

    name: str = ""  # the target, as people write it
    identity: str = ""  # which board it is: serial number, or what a simulated one may say of itself
    lock_step: bool = False
    stream: bool = False
    facts: Mapping[str, str]
    can_reopen: bool = False  # a board on a cable, which may be plugged in again
    is_known_again: bool = False  # it has a serial number by which :meth:`reopen` tells it from others
    counts_per_rev: int | None = None  # where the board is known better than by its profile
    passed_over: int = 0  # reports that came with a newer one and were never read

    @abstractmethod
    def open(self) -> None:
        """Take the line. Raises TransportError, saying what holds it up and what to do."""

    @abstractmethod
    def send(self, report: bytes) -> None:
        """Hand one report to the board. Raises TransportError, DisconnectedError."""

    @abstractmethod
    def receive(self, timeout_s: float) -> bytes:
        """The newest report of the board, or of a stream what has come since the last call, at least one byte.

        Raises TelemetryTimeoutError after *timeout_s*, DisconnectedError.
        A board in lock step does one task step and may send nothing in it: TelemetryTimeoutError.
        """

    @abstractmethod
    def close(self) -> None:
        """Give the line back; harmless when it is not open."""

    def reopen(self) -> None:
        """Take the line to the same board again after it went away, wherever it is now; to be tried until it works.

        Raises TransportError while the board is not back.
        """
        raise DisconnectedError(f"{self.name} does not come back: open it anew")

    @property
    def way(self) -> Way | None:
        """How a guardian reaches the open line; None where there is no motor that could run on."""
        return None

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
