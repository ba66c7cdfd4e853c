"""Strict reading of the tables in a plant file: what is not understood is refused by key and reason."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Any

from firmware_model.effect import Parameter
from firmware_model.errors import FirmwareModelError

# Degrees are what people measure; the kernel computes in radians.
BIGGEST = 1e6  # of what has no limit of its own: torques, voltages, stiffnesses; beyond it nothing can be computed
CONVERSIONS = {("deg", "rad"): math.pi / 180.0, ("deg_s", "rad_s"): math.pi / 180.0}


def _accepted(key: str) -> dict[str, float]:
    """The spellings of a key with their factors to the unit in it."""
    spellings = {key: 1.0}
    for (given, wanted), factor in CONVERSIONS.items():
        if key.endswith(f"_{wanted}"):
            spellings[key.removesuffix(wanted) + given] = factor
    return spellings


def unknown(key: str, known: Iterable[str], where: str) -> FirmwareModelError:
    """The refusal of a key nobody reads; a key with a known stem and another unit is told so."""
    names = sorted(known)
    stem = key.split("_")[0].lower()
    same = [name for name in names if name.split("_")[0].lower() == stem and "_" in name]
    if len(same) == 1:
        unit = same[0].split("_", 1)[1]
        return FirmwareModelError(f"{where}: key {key!r} has the wrong unit; write {same[0]!r} (unit {unit})")
    near = difflib.get_close_matches(key, names, n=1, cutoff=0.4)
    hint = f"; did you mean {near[0]!r}?" if near else f"; known keys: {', '.join(names)}"
    return FirmwareModelError(f"{where}: unknown key {key!r}{hint}")


def number(value: Any, key: str, where: str, lower: float, upper: float) -> float:
    """A finite number within its limits."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise FirmwareModelError(f"{where}: {key} must be a number, not {value!r}")
    try:
        result = float(value)
    except OverflowError:
        raise FirmwareModelError(f"{where}: {key} is a whole number of hundreds of digits") from None
    if not math.isfinite(result):
        raise FirmwareModelError(f"{where}: {key} must be finite, not {value}")
    if abs(result) > BIGGEST:
        raise FirmwareModelError(f"{where}: {key} = {value} is beyond what any motor has ({BIGGEST:g})")
    if result < lower:
        raise FirmwareModelError(f"{where}: {key} = {value} is below its least value {lower:g}")
    if result > upper:
        raise FirmwareModelError(f"{where}: {key} = {value} is above its largest value {upper:g}")
    return result


def parameters(table: Mapping[str, Any], wanted: tuple[Parameter, ...], where: str) -> dict[str, Any]:
    """Read a table of parameters: every key known, every needed one there, every value within its limits."""
    spellings = {spelling: (q, factor) for q in wanted for spelling, factor in _accepted(q.key).items()}
    values: dict[str, Any] = {}
    for key, value in table.items():
        if key not in spellings:
            raise unknown(key, spellings, where)
        parameter, factor = spellings[key]
        if parameter.key in values:
            raise FirmwareModelError(f"{where}: {parameter.key} is given twice, the second time as {key!r}")
        if parameter.choices:
            if value not in parameter.choices:
                raise FirmwareModelError(f"{where}: {key} must be one of {', '.join(parameter.choices)}, not {value!r}")
            values[parameter.key] = value
        else:
            lower, upper = parameter.lower / factor, parameter.upper / factor
            values[parameter.key] = number(value, key, where, lower, upper) * factor
    for parameter in wanted:
        if parameter.key in values:
            continue
        if parameter.default is None:
            raise FirmwareModelError(f"{where}: key {parameter.key!r} is missing")
        values[parameter.key] = parameter.choices[int(parameter.default)] if parameter.choices else parameter.default
    return values
