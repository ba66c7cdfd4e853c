"""The unit converter of the control lab's window (section D-3), for quantities of benches and motors.

Units and their algebra are pint's. Three of a bench's own are added: ``count`` of its encoder, ``duty_pct`` of its
supply (a voltage) and ``car_cm``, the height of the elevator's car for an angle of its drum.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import cache
from typing import Any

from fiohost.errors import ConfigError

COUNTS_PER_TURN, SUPPLY_V, DRUM_CM = 720.0, 4.5, 1.375
LONGEST = 60
# names with one-digit exponents, multiplied or divided: no numbers, so nothing that takes long to work out
_NAME = r"[A-Za-z_\u00b5\u03bc\u03a9\u2126\u00b0%]+(?:(?:\*\*|\^)-?[1-9])?"
_UNIT = re.compile(rf"{_NAME}(?:\s*[*/ \u00b7]\s*{_NAME})*")
# What a quantity is shown in where no unit is asked for
COMMON = (
    ("deg", "rad", "turn", "count", "car_cm"), ("deg/s", "rad/s", "rpm"), ("V", "mV", "duty_pct"), ("A", "mA"),
    ("N*m", "mN*m", "kgf*cm", "ozf*inch"), ("N*m*s", "mN*m*s"), ("kg*m**2", "g*cm**2", "oz*inch**2"), ("H", "mH"),
    ("ohm", "kohm"), ("N*m/A", "mN*m/A", "ozf*inch/A"), ("V*s/rad", "V/krpm"), ("m", "cm", "mm", "inch"),
    ("kg", "g", "oz"), ("s", "ms"), ("Hz", "kHz"), ("N", "kgf", "lbf"),
)  # fmt: skip


@dataclass(frozen=True)
class Converted:
    """A value in a unit, and the same in others."""

    value: float
    unit: str
    others: tuple[tuple[float, str], ...]


@cache
def registry(counts_per_turn: float, supply_V: float, drum_cm: float) -> Any:
    """Pint's units with those of one bench."""
    import pint

    found: Any = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
    found.define(f"count = {1.0 / counts_per_turn!r} * turn")
    found.define(f"duty_pct = {0.01 * supply_V!r} * volt")
    found.define(f"car_cm = {1.0 / drum_cm!r} * radian")
    found.define("krpm = 1000 * rpm")
    return found


def convert(
    value: float, unit: str, to: str | None = None, *, counts_per_turn: float = COUNTS_PER_TURN,
    supply_V: float = SUPPLY_V, drum_cm: float = DRUM_CM,
) -> Converted:  # fmt: skip
    """A value of one unit in another, or without one in those that are common for it. Raises ConfigError."""
    import pint

    units = registry(counts_per_turn, supply_V, drum_cm)
    begin = _parsed(unit, units)
    given = units.Quantity(value, begin)
    asked = [to] if to is not None else [name for name in _common(begin, units) if name != unit]
    others = []
    for name in asked:
        try:
            found = float(given.to(_parsed(name, units)).magnitude)
        except pint.DimensionalityError as exc:
            raise ConfigError(f"{unit} and {name} are units of different quantities: {exc}") from exc
        except (OverflowError, ZeroDivisionError) as exc:
            raise ConfigError(f"{value:g} {unit} is no number in {name}") from exc
        if not math.isfinite(found):
            raise ConfigError(f"{value:g} {unit} is too large for {name}")
        others.append((found, name))
    if not others:
        raise ConfigError(f"no common units are known for {unit}: name the one that is wanted")
    return Converted(value, unit, tuple(others))


def _parsed(text: str, units: Any) -> Any:
    """A unit by its name. Raises ConfigError naming the nearest one."""
    import pint

    clean = text.strip()
    if len(clean) > LONGEST or not _UNIT.fullmatch(clean):
        raise ConfigError(f"{text[:40]!r} is no unit: write names with * / and ^, as N*m/A or rad/s")
    try:
        return units.parse_units(clean.replace("^", "**").replace("%", "percent"))
    except pint.UndefinedUnitError as exc:
        from fiohost.settings import nearest

        known = sorted({name for group in COMMON for name in group})
        raise ConfigError(f"unknown unit {text[:40]!r}; {nearest(clean, known)}") from exc
    except (pint.PintError, TypeError, ValueError, AttributeError) as exc:
        raise ConfigError(f"{text[:40]!r} is no unit: {exc}") from exc


def _common(unit: Any, units: Any) -> tuple[str, ...]:
    """The common units of the same quantity: an angle is no pure number here."""
    for group in COMMON:
        first = units.parse_units(group[0])
        if unit.is_compatible_with(first) and _turns(unit) == _turns(first):
            return group
    return ()


def _turns(unit: Any) -> bool:
    names = ("radian", "degree", "turn", "count", "car_cm", "revolution", "rpm")
    return any(name in str(unit) for name in names)
