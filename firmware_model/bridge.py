"""The bridge LB1836M: what the winding sees for the four settings of C3 and C4 (lab text, Table 2.3)."""

from __future__ import annotations

from firmware_model.report import PERIOD, Command

# Modes of the winding, as the kernel knows them.
STANDBY = 0  # open: no current
DRIVEN = 1  # on for the duty; for the rest of each period shorted (slow decay) or open (fast decay)
BRAKE = 2  # shorted all the time

TRUTH_TABLE = {(1, 0): (DRIVEN, 1.0), (0, 1): (DRIVEN, -1.0), (1, 1): (BRAKE, 0.0), (0, 0): (STANDBY, 0.0)}


def drive(command: Command, period: int = PERIOD) -> tuple[int, float]:
    """Mode and signed duty in percent of full scale; a compare value beyond the *period* stays on."""
    mode, sign = TRUTH_TABLE[command.c3, command.c4]
    return mode, sign * 100.0 * min(command.compare, period) / period
