"""What stands between the chip's pins and the winding, from the bridges' datasheets and the wiring of docs/firmware.md.

Written beside the firmware's table, not from it: a fault in one shows against the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from firmware_model.bridge import BRAKE, DRIVEN, STANDBY
from firmware_model.emulated.chip import LOW, Chip, Level

# lines of a bridge -> pins of the chip, by board and bridge
PINS: Mapping[tuple[str, str], Mapping[str, str]] = MappingProxyType(
    {
        ("uno", "tb6612"): {"in1": "PB0", "pwm": "PB1", "in2": "PB2", "stby": "PB4"},
        ("uno", "l298n"): {"in1": "PB0", "en": "PB1", "in2": "PB2"},
        ("uno", "drv8833"): {"in1": "PB1", "in2": "PB2", "sleep": "PB4"},
        ("bluepill", "tb6612"): {"in1": "PB12", "pwm": "PA3", "in2": "PB13", "stby": "PB14"},
        ("bluepill", "l298n"): {"in1": "PB12", "en": "PA3", "in2": "PB13"},
        ("bluepill", "drv8833"): {"in1": "PA2", "in2": "PA3", "sleep": "PB14"},
    }
)


def winding(chip: Chip, board: str, bridge: str) -> tuple[int, float]:
    """Mode of the winding and signed duty in percent. A line that nobody drives is low: each has a pull-down."""
    lines = {line: chip.output(pin) or LOW for line, pin in PINS[board, bridge].items()}
    return _OF[bridge](lines)


def _tb6612(lines: Mapping[str, Level]) -> tuple[int, float]:
    """STBY low: open. IN1 IN2: 11 short brake; 10, 01 driven while PWM is high, short brake while low; 00 open."""
    in1, in2 = lines["in1"].high, lines["in2"].high
    if not lines["stby"].high or not (in1 or in2):
        return STANDBY, 0.0
    if in1 and in2:
        return BRAKE, 0.0
    return DRIVEN, _percent(lines["pwm"]) * (1 if in1 else -1)


def _l298n(lines: Mapping[str, Level]) -> tuple[int, float]:
    """EN low: open. EN high: 10, 01 driven; 11 and 00 short the winding through two switches of one side."""
    in1, in2, enabled = lines["in1"].high, lines["in2"].high, lines["en"]
    if not enabled.high:
        return STANDBY, 0.0
    if bool(in1) == bool(in2):  # a pulsed brake would be a weaker one; the firmware has none
        return (BRAKE, 0.0) if enabled.high >= enabled.period else (STANDBY, 0.0)
    return DRIVEN, _percent(enabled) * (1 if in1 else -1)


def _drv8833(lines: Mapping[str, Level]) -> tuple[int, float]:
    """nSLEEP low: open. 10 forward, 01 reverse, 11 brake, 00 open; with one input high the other's low time drives."""
    in1, in2 = lines["in1"], lines["in2"]
    if not lines["sleep"].high or not (in1.high or in2.high):
        return STANDBY, 0.0
    if in1.share >= 1.0 and in2.share >= 1.0:
        return BRAKE, 0.0
    if in1.share >= 1.0:
        return DRIVEN, 100.0 * (in2.period - in2.high) / in2.period
    if in2.share >= 1.0:
        return DRIVEN, -100.0 * (in1.period - in1.high) / in1.period
    return DRIVEN, _percent(in1) - _percent(in2)


def _percent(level: Level) -> float:
    return 100.0 * min(level.high, level.period) / level.period


_OF = {"tb6612": _tb6612, "l298n": _l298n, "drv8833": _drv8833}
