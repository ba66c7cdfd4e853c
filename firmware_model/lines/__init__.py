"""Ways to reach the board from outside this process: one file each, all with ``receive``, ``send`` and ``close``."""

from __future__ import annotations

from typing import Protocol


class Line(Protocol):
    """The board's end of a line. Neither call ever waits: the board's task goes on whatever the host does."""

    stream: bool  # receive gives pieces of a stream, not whole reports
    where: str  # what the host opens, for people

    def receive(self) -> list[bytes]:
        """What has come since the last call, oldest first; empty also while no host is there."""

    def send(self, report: bytes) -> None:
        """One report to the host; lost where nobody takes it."""

    def close(self) -> None:
        """Unplug."""
