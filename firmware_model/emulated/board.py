"""A board of machine code in lock step with its motor: one clock, which is the chip's.

The motor is run ahead under the outputs of now, and its edges are handed to the chip. Where the chip changes an output
before they have all come, the motor goes back and takes the same way only up to there.
"""

from __future__ import annotations

from firmware_model.board import STEP_S, start_of
from firmware_model.bridge import STANDBY
from firmware_model.emulated.chip import Chip
from firmware_model.emulated.wiring import winding
from firmware_model.errors import FirmwareModelError
from firmware_model.plants import Plant
from firmware_model.quadrature import EdgeMotor
from firmware_model.thermal import ThermalShutdown

COUNTS_PER_REV = 720  # what the firmware is built for
PWM_HZ = 20e3
BOOT_S = 0.1
BEHIND_S = 0.0015  # a step ends so long after the first byte of a report: report and answer are out by then


class EmulatedBoard:
    """A chip, a bridge, a motor. :meth:`step` takes bytes of the serial line and gives those that came back in 5 ms.

    ``seed`` as of a simulated board. Of the plant's options the pull-ups and the watchdog are the firmware's own
    affair. Raises FirmwareModelError for a plant with faults of the line, another encoder or another PWM.
    """

    def __init__(self, chip: Chip, plant: Plant, board: str, bridge: str, *, seed: int | None = None) -> None:
        if plant.counts_per_rev != COUNTS_PER_REV:
            raise FirmwareModelError(
                f"plant {plant.name!r} has {plant.counts_per_rev} counts a turn, the firmware is built for "
                f"{COUNTS_PER_REV}"
            )
        if plant.pwm_hz != PWM_HZ:
            raise FirmwareModelError(f"plant {plant.name!r} has pwm_hz = {plant.pwm_hz:g}, the firmware {PWM_HZ:g}")
        if plant.faults is not None:
            raise FirmwareModelError(f"plant {plant.name!r} has faults of the line: they need a simulated board")
        within_count, within_gap = start_of(seed)
        self.chip = chip
        self._motor = EdgeMotor(plant, within_count=within_count, within_gap=within_gap)
        self._where = board, bridge
        self._thermal = ThermalShutdown(plant.thermal_shutdown) if plant.thermal_shutdown else None
        self._acting = self._outputs()
        self._fresh: tuple[int, float] | None = self._acting
        self._first = self._boot()
        self._due_s = chip.time_s

    @property
    def outputs(self) -> tuple[int, float]:
        """Mode of the winding and signed duty in percent, now."""
        return self._acting

    @property
    def motor(self) -> EdgeMotor:
        """What turns; for looking at."""
        return self._motor

    def step(self, data: bytes = b"") -> bytes:
        """Let one step of the task pass while *data* arrive; the bytes that came back. The first one is of the boot."""
        if data:
            self.chip.receive(data)
        if self._first:
            first, self._first = self._first, b""
            return first
        self._due_s += STEP_S
        self.run_to(self._due_s)
        if self._thermal is not None:
            self._thermal.pass_time(self._motor.current_A, STEP_S)
        return self.chip.sent()

    def run_to(self, time_s: float) -> None:
        """Let chip and motor go on to a time on the chip's clock."""
        chip, motor = self.chip, self._motor
        end_s = time_s - 1.0 / chip.hertz  # a chip stops at whole cycles
        while chip.time_s < end_s:
            began = motor.save()
            chip.put_edges(motor.run_to(time_s, self._fresh))
            chip.run_to(time_s)
            outputs = self._outputs()
            if outputs == self._acting:
                if chip.time_s < end_s:  # something else changed: what was foretold holds
                    motor.restore(began)
                    motor.run_to(chip.time_s, self._fresh)
                self._fresh = None
                continue
            motor.restore(began)
            motor.run_to(chip.time_s, self._fresh)
            self._acting = self._fresh = outputs

    def _outputs(self) -> tuple[int, float]:
        if self._thermal is not None and self._thermal.open:
            return STANDBY, 0.0
        return winding(self.chip, *self._where)

    def _boot(self) -> bytes:
        """Power on, until the first report is out."""
        sent = b""
        while not sent:
            if self.chip.time_s > BOOT_S:
                raise FirmwareModelError(f"the firmware says nothing within {BOOT_S:g} s of its start")
            self.run_to(self.chip.time_s + 2e-5)
            sent = self.chip.sent()
        self.run_to(self.chip.time_s + BEHIND_S)
        return sent + self.chip.sent()
