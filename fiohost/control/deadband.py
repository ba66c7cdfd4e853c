"""Deadband compensation, Eq. 2.6 of the lab text: the inverse of the dead zone at the motor's input (Eq. 2.5)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fiohost.errors import ConfigError


@dataclass(frozen=True)
class DeadbandCompensator:
    """Adds ``u_plus_pct`` (>= 0) to positive commands and ``u_minus_pct`` (<= 0) to negative ones.

    Commands of at most ``threshold_pct`` in size give 0. The text's advice: choose both smaller than the measured
    deadband, since compensating all of it makes the loop jitter. Raises ConfigError for a wrong sign.
    """

    u_plus_pct: float = 0.0
    u_minus_pct: float = 0.0
    threshold_pct: float = 0.0

    def __post_init__(self) -> None:
        if not (0.0 <= self.u_plus_pct < 100.0 and -100.0 < self.u_minus_pct <= 0.0):
            raise ConfigError(
                f"deadband compensation with u_plus_pct = {self.u_plus_pct:g} and u_minus_pct = {self.u_minus_pct:g}: "
                "u_plus_pct is 0 to 100, u_minus_pct is -100 to 0"
            )
        if not (math.isfinite(self.threshold_pct) and self.threshold_pct >= 0.0):
            raise ConfigError(f"deadband threshold_pct = {self.threshold_pct:g} is not 0 or more")

    def apply(self, duty_pct: float) -> float:
        """The command that reaches the motor as *duty_pct* behind its deadband, in percent; not yet limited."""
        if -self.threshold_pct <= duty_pct <= self.threshold_pct:
            return 0.0
        return duty_pct + (self.u_plus_pct if duty_pct > 0.0 else self.u_minus_pct)  # NaN stays NaN
