"""The full scale of a foreign command: percent, a share, PWM steps, or volts of a supply."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiohost.importing import units as u
from fiohost.importing.raw import RawColumn
from fiohost.importing.roles import Head

USUAL_SUPPLIES_V = (3.3, 5.0, 6.0, 7.2, 9.0, 12.0, 15.0, 18.0, 24.0, 36.0, 48.0, 60.0, 80.0, 110.0, 230.0, 400.0)
PWM_STEPS = (255.0, 1023.0, 4095.0, 65_535.0)
FAR_BELOW = 0.24  # of the steps: a command that stays below may as well be one of a timer that counts to another top
DUTY_WORDS = frozenset(
    {"duty", "pwm", "dutycycle", "tastgrad", "tastverhaeltnis", "power", "leistung", "throttle", "stellgrad"}
    | {"aussteuerung", "command", "cmd"}
)
VOLT_WORDS = frozenset({"voltage", "volt", "volts", "spannung", "motorspannung", "ankerspannung"})
ROUNDING = 1.0001
FULL_SCALE = (
    r"(?:full[ _]?scale|supply|versorgung\w*|v_?max|u_?max|vbat\w*|batter\w+|nominal voltage|nennspannung"
    r"|max\w* voltage|bus voltage|of|von)[^\d\n-]{0,14}?(\d+(?:[.,]\d+)?)\s*V\b"
)


@dataclass(frozen=True)
class Scale:
    """How the command becomes percent of full scale; ``line`` and ``assumed`` say it in words."""

    scale: float
    unit: str
    line: str
    full_scale_V: float = 0.0
    assumed: str = ""


def scale_of(
    command: Head, columns: Sequence[RawColumn], supply: Head | None, titles: Sequence[str], told: float | None
) -> Scale | None:
    """The scale of a command; None where nobody can know it. *columns* are its column in all tables of a bench."""
    values = np.concatenate([c.values[np.isfinite(c.values)] for c in columns])
    largest = float(np.abs(values).max()) if values.size else 0.0
    name = command.column.name
    measures = command.unit.measures if command.unit else ""
    base = command.unit.base if command.unit else ""
    factor = command.unit.scale if command.unit else 1.0
    if told is not None:
        if base == "V":
            return _volts(told / factor if factor != 1.0 else told, factor, f"full scale {told:g} V", "")
        return Scale(100.0 / told, command.unit_text, f"full scale {told:g} {command.unit_text}".rstrip())
    if measures == u.RATIO:
        return Scale(factor, "%", "in percent of full scale")
    if measures == u.VOLTAGE:
        return _voltage(command, largest, factor, supply, titles)
    if measures in (u.TORQUE, u.CURRENT):
        full = _rounded_up(largest * factor)
        return Scale(
            100.0 * factor / full, base, f"{base}, full scale {full:g} {base}",
            assumed=f"full scale of {name!r} is {full:g} {base}, a round number above the largest, "
            f"{largest * factor:g} (--full-scale)",
        )  # fmt: skip
    if not measures and command.words & VOLT_WORDS:
        scale = _voltage(command, largest, factor, supply, titles)
        said = f"; {scale.assumed}" if scale.assumed else ""
        return replace(scale, assumed=f"{name!r} is in V{said}")
    if not command.words & DUTY_WORDS:
        return None
    whole = bool(np.all(values == np.rint(values)))
    if largest <= 1.0 * ROUNDING and not (whole and largest == 0.0):
        return Scale(100.0, "", "a share of full scale", assumed=f"{name!r}, within -1 to 1, is a share of full scale")
    if largest <= 100.0 * ROUNDING:
        return Scale(1.0, "%", "in percent of full scale", assumed=f"{name!r}, up to {largest:g}, is in percent")
    steps = next((size for size in PWM_STEPS if largest <= size), None)
    if not whole or steps is None or largest < FAR_BELOW * steps:
        return None
    line = f"PWM steps of {steps:g}"
    return Scale(
        100.0 / steps, "", line, assumed=f"{name!r}, whole numbers up to {largest:g}, are PWM steps of {steps:g}"
    )


def _voltage(command: Head, largest: float, factor: float, supply: Head | None, titles: Sequence[str]) -> Scale:
    for text in (command.column.name, command.column.unit, *titles):
        found = re.search(FULL_SCALE, text, re.IGNORECASE)
        if found:
            full = float(found[1].replace(",", "."))
            if full >= largest * factor:
                return _volts(full / factor, factor, f"V, full scale {full:g} V as the table says", "")
    if supply is not None and supply.unit is not None:
        full = float(np.nanmedian(supply.column.values)) * supply.unit.scale
        if full >= largest * factor:
            full = float(f"{full:.4g}")
            said = f"full scale is {full:g} V, the median of {supply.column.name!r}"
            return _volts(full / factor, factor, f"V, full scale {full:g} V", said)
    top = largest * factor
    full = next((size for size in USUAL_SUPPLIES_V if top <= size * ROUNDING), _rounded_up(top))
    name = command.column.name
    said = f"full scale of {name!r} is {full:g} V, the usual supply above its largest value, {top:.4g} V (--full-scale)"
    return _volts(full / factor, factor, f"V, full scale {full:g} V", said)


def _volts(full: float, factor: float, line: str, assumed: str) -> Scale:
    """Full scale in the column's unit."""
    if factor == 1.0:
        return Scale(100.0 / full, "V", line, full_scale_V=full, assumed=assumed)
    return Scale(100.0 / full, "mV" if factor == 1e-3 else "V", line, assumed=assumed)


def _rounded_up(value: float) -> float:
    """The next of 1, 2, 5 times a power of ten."""
    if value <= 0.0:
        return 1.0
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(f"{m * power:.6g}" for m in (1, 2, 5, 10) if value <= m * power * ROUNDING))
