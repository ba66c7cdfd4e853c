"""What the tick loop asks at each tick: the command for this reading, or None to end the run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from fiohost.control.law import ControlLaw
from fiohost.wire.messages import Command

Answer = tuple[Command, float | None]  # the command, and the reference in degrees (None in open loop)


class Program(Protocol):
    def step(self, k: int, angle_deg: float) -> Answer | None:
        """Answer the reading of tick *k*. *angle_deg* is POS/2 made continuous: it does not jump at 0 and 360.

        Ticks whose telemetry was lost are not asked for: *k* may grow by more than one.
        """


class Hold:
    """One command for a number of ticks, or without end."""

    def __init__(self, command: Command, ticks: int | None = None) -> None:
        self._answer: Answer = (command, None)
        self._ticks = ticks

    def step(self, k: int, angle_deg: float) -> Answer | None:
        return None if self._ticks is not None and k >= self._ticks else self._answer


class OpenLoop:
    """Commands known beforehand, one for each tick."""

    def __init__(self, commands: Sequence[Command]) -> None:
        self._answers: list[Answer] = [(command, None) for command in commands]

    def step(self, k: int, angle_deg: float) -> Answer | None:
        return self._answers[k] if k < len(self._answers) else None


class ClosedLoop:
    """A control law that follows a reference known beforehand, one value (deg) for each tick."""

    def __init__(self, law: ControlLaw, refs_deg: Sequence[float]) -> None:
        self._law = law
        self._refs = refs_deg
        law.reset()

    def step(self, k: int, angle_deg: float) -> Answer | None:
        if k >= len(self._refs):
            return None
        ref = self._refs[k]
        return Command.drive(self._law.step(ref, angle_deg)), ref
