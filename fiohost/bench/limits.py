"""What a bench may do, enforced at one place: between the program's command and the wire.

Duty, travel and run time end a run (the bench brakes and says which limit it was); the slew limit lets the duty follow
its command no faster. Braking and coasting are always allowed at once.
"""

from __future__ import annotations

import math

from fiohost.errors import LimitError
from fiohost.transport.profile import Limits
from fiohost.wire.messages import DRIVE, Command


class Limiter:
    """The limits of one run. ``slowed`` counts commands that the slew limit has held back."""

    def __init__(self, limits: Limits, sample_time_s: float) -> None:
        self._limits = limits
        self._slews = math.isfinite(limits.slew_pct_per_s)
        self._start_deg: float | None = None
        self._duty_pct = 0.0
        self._time_s = -sample_time_s
        self.slowed = 0

    def allow(self, command: Command, angle_deg: float, time_s: float) -> Command:
        """The command that may be sent at *time_s* of the run with the shaft at *angle_deg*. Raises LimitError."""
        limits = self._limits
        if self._start_deg is None:
            self._start_deg = angle_deg
        if time_s >= limits.run_time_s:
            raise LimitError(f"the run has lasted for this target's limit of {limits.run_time_s:g} s: braked")
        if abs(angle_deg - self._start_deg) > limits.travel_deg:
            raise LimitError(
                f"the shaft is {angle_deg - self._start_deg:+.1f} deg from where the run began, beyond this target's "
                f"travel limit of {limits.travel_deg:g} deg: braked"
            )
        if abs(command.duty_pct) > limits.duty_pct:
            raise LimitError(
                f"a duty of {command.duty_pct:g} % is beyond this target's limit of {limits.duty_pct:g} %: braked"
            )
        if self._slews:
            command = self._slewed(command, time_s)
        return command

    def _slewed(self, command: Command, time_s: float) -> Command:
        step = self._limits.slew_pct_per_s * (time_s - self._time_s)
        self._time_s = time_s
        if command.mode == DRIVE:
            wanted = command.duty_pct
            allowed = min(max(wanted, self._duty_pct - step), self._duty_pct + step)
            if allowed != wanted:
                self.slowed += 1
                command = Command.drive(allowed)
        self._duty_pct = command.duty_pct
        return command
