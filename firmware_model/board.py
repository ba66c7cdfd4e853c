"""The board: one task step every 5 ms from reports to telemetry, the motor turning in between."""

from __future__ import annotations

import random

from firmware_model.bridge import STANDBY, drive
from firmware_model.formats import make_format
from firmware_model.motor import Motor
from firmware_model.plants import Plant
from firmware_model.report import PERIOD, Command
from firmware_model.thermal import ThermalShutdown

STEP_S = 0.005
_OFF = Command(compare=0, c3=0, c4=0)
_BRAKE = Command(compare=0, c3=1, c4=1)


class Board:
    """A board with its motor. All that leaves it is the bytes returned by :meth:`step`.

    ``seed`` draws what nobody can know of a bench before it moves: the shaft's angle within its first count and the
    place of the gears in their play. Without a seed the shaft starts in the middle of its count and of the play.
    ``pwm`` ("averaged" or "edge_resolved") takes the place of the plant's own key. ``layout`` names the reports that
    the board speaks (see :mod:`firmware_model.formats`), ``duty_steps`` are the timer's ticks of a PWM period.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        seed: int | None = None,
        pwm: str | None = None,
        layout: str = "assumed",
        duty_steps: int = PERIOD,
    ) -> None:
        self._format = make_format(layout, duty_steps)
        self._duty_steps = duty_steps
        within_count, within_gap = start_of(seed)
        self._motor = Motor(plant, within_count=within_count, within_gap=within_gap, pwm=pwm)
        self._counts_per_rev = plant.counts_per_rev
        self._pull_ups = plant.pull_ups
        self._watchdog_s = plant.watchdog["timeout_s"] if plant.watchdog else None
        self._thermal = ThermalShutdown(plant.thermal_shutdown) if plant.thermal_shutdown else None
        self._command = _OFF
        self._silent_s = 0.0
        self.step_s = STEP_S
        self.powered = True  # the motor's supply; the board lives on its own

    def step(self, report: bytes | None, *, span_s: float = STEP_S) -> bytes:
        """One task step: latch the newest report (None or an invalid one: outputs hold), sample, send, run on.

        Returns one report of telemetry as sampled at the start of the step. The latched command acts until the next
        step, which comes after ``span_s``.
        """
        command = self._format.parse(report) if report is not None else None
        if command is not None:
            self._command, self._silent_s = command, 0.0
        motor = self._motor
        sent = self._format.telemetry(motor.direction, motor.count % self._counts_per_rev)
        mode, duty_pct = self._outputs()
        motor.run(mode, duty_pct, span_s)
        self._silent_s += span_s
        if self._thermal is not None:
            self._thermal.pass_time(motor.current_A, span_s)
        return sent

    def reset(self) -> None:
        """What the controller's reset does: outputs off, encoder timer at 0 counting up. The motor runs on."""
        self._command, self._silent_s = _OFF, 0.0
        self._motor.reset_counter()
        self._format.reset()

    def _outputs(self) -> tuple[int, float]:
        """Mode of the bridge and signed duty, from the latched command and all that stands between it and the motor."""
        if not self.powered or (self._thermal is not None and self._thermal.open):
            return STANDBY, 0.0
        command = self._command
        if self._watchdog_s is not None and self._silent_s >= self._watchdog_s - 1e-9:
            command = _BRAKE
        if not self._pull_ups:  # the open-drain pins can pull down only
            command = command._replace(c3=0, c4=0)
        return drive(command, self._duty_steps)


def start_of(seed: int | None) -> tuple[float, float]:
    """Where the shaft stands in its count and the gears in their play (0..1), as *seed* draws it."""
    if seed is None:
        return 0.5, 0.5
    rng = random.Random(f"start {seed}")
    return rng.random(), rng.random()
