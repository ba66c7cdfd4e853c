"""The board: one task step every 5 ms from reports to telemetry, the motor turning in between."""

from __future__ import annotations

import random

from firmware_model.bridge import drive
from firmware_model.motor import Motor
from firmware_model.plants import Plant
from firmware_model.report import Command, parse, telemetry

STEP_S = 0.005
_START = Command(compare=0, c3=0, c4=0)


class Board:
    """A board with its motor. All that leaves it is the bytes returned by :meth:`step`.

    ``seed`` draws what nobody can know of a bench before it moves: the shaft's angle within its first count and the
    place of the gears in their play. Without a seed the shaft starts in the middle of its count and of the play.
    """

    def __init__(self, plant: Plant, *, seed: int | None = None) -> None:
        rng = random.Random(f"start {seed}") if seed is not None else None
        within_count = rng.random() if rng else 0.5
        within_gap = rng.random() if rng else 0.5
        self._motor = Motor(plant, within_count=within_count, within_gap=within_gap)
        self._counts_per_rev = plant.counts_per_rev
        self._command = _START
        self._mode, self._duty_pct = drive(_START)

    def step(self, report: bytes | None) -> bytes:
        """One task step: latch the newest report (None or an invalid one: outputs hold), sample, send, run for 5 ms.

        Returns 64 bytes of telemetry as sampled at the start of the step. The latched command acts until the next step.
        """
        if report is not None:
            command = parse(report)
            if command is not None and command != self._command:
                self._command = command
                self._mode, self._duty_pct = drive(command)
        motor = self._motor
        sent = telemetry(motor.direction, motor.count % self._counts_per_rev)
        motor.run(self._mode, self._duty_pct, STEP_S)
        return sent
