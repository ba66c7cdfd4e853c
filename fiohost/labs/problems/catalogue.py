"""All problems: what each is about and the numbers that it is asked with, which may be set to others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from math import isfinite

from fiohost.errors import ConfigError
from fiohost.labs.problems.answer import MOTOR_KEYS
from fiohost.labs.result import LabResult
from fiohost.settings import nearest

D1 = dict(zip(MOTOR_KEYS, (2.0, 0.008, 0.1, 0.1, 0.0004, 0.001), strict=True))
_STEP = D1 | {"volts": 5.0, "seconds": 10.0}
_SPEED = D1 | {"ref_rad_s": 10.0, "kp": 0.1, "amplifier": 2.0, "seconds": 2.0}
_ANGLE = D1 | {"ref_rad": 1.0, "kp": 1.0, "amplifier": 1.0, "seconds": 1.0}
_PID = D1 | {
    "ref_rad": 1.0, "largest_V": 5.0, "omega_rad_s": 15.0, "load_Nm": -0.1, "load_from_s": 4.0, "seconds": 12.0,
}  # fmt: skip

BOUNDS = {"seconds": (1e-3, 1e3), "load_from_s": (0.0, 1e3), "amplifier": (1e-6, 1e6), "overshoot_pct": (0.1, 60.0),
          "most_overshoot_pct": (0.1, 60.0)}  # fmt: skip
POSITIVE = ("ref_rad", "ref_rad_s", "largest_V", "omega_rad_s", "limit_V", "limit_A", "inertia_factor", "kp",
            "sensor_V_s_per_rad", "volts")  # fmt: skip
LARGEST = 1e6


@dataclass(frozen=True)
class Problem:
    """A problem and its numbers as the text gives them."""

    number: int
    module: str
    about: str
    numbers: Mapping[str, float]

    def solve(self, changes: Mapping[str, float] | None = None) -> LabResult:
        """Answer it, some numbers changed. Raises ConfigError for a number that it has not or cannot have."""
        for key, value in (changes or {}).items():
            if key not in self.numbers:
                raise ConfigError(f"D-{self.number} has no number {key!r}; {nearest(key, self.numbers)}")
            low, high = BOUNDS.get(key, (1e-9 if key in POSITIVE else -LARGEST, LARGEST))
            if not (isfinite(value) and low <= value <= high):
                raise ConfigError(f"{key} = {value:g} is outside {low:g}..{high:g}")
        numbers = {**D1, **self.numbers, **(changes or {})}
        if numbers.get("load_from_s", 0.0) >= numbers["seconds"]:
            raise ConfigError("load_from_s is not before the end of the run (seconds)")
        solve = getattr(import_module(f"fiohost.labs.problems.{self.module}"), f"d{self.number}")
        found: LabResult = solve(numbers)
        return found


def _without(numbers: Mapping[str, float], *keys: str) -> dict[str, float]:
    """The numbers of a problem that fixes some of them itself."""
    return {key: value for key, value in numbers.items() if key not in keys}


def _all() -> dict[int, Problem]:
    speed = _without(_SPEED, "L_H")
    load_1 = {"load_Nm": -0.1, "load_from_s": 0.5}
    load_2 = {"load_Nm": -0.2, "load_from_s": 1.0}
    wide = _ANGLE | {"seconds": 3.0}
    table: list[tuple[str, str, Mapping[str, float]]] = [
        ("open_loop", "speed and current after a step of voltage", _STEP),
        ("open_loop", "the same without viscous friction", _without(_STEP, "B_Nms") | {"other_volts": 10.0}),
        (
            "open_loop",
            "the same without inductance, and with more inertia",
            _without(_STEP, "B_Nms", "L_H") | {"inertia_factor": 2.0},
        ),
        ("open_loop", "D-1 to D-3 with a load from 0.5 s on", _STEP | load_1),
        ("open_loop", "D-1 to D-3 with a load from 1 s on", _STEP | load_2),
        ("open_loop", "an amplifier before the motor", _without(_STEP, "L_H") | {"amplifier": 2.0, "seconds": 2.0}),
        ("speed_loop", "speed under P control", speed),
        ("speed_loop", "a larger gain, with and without limits", speed | {"kp": 1.0, "limit_V": 4.5, "limit_A": 1.0}),
        ("speed_loop", "D-7 with a load from 0.5 s on", speed | load_1),
        ("speed_loop", "D-7 with a load from 1 s on", speed | load_2),
        ("speed_loop", "a speed sensor in the loop", speed | {"sensor_V_s_per_rad": 0.2, "seconds": 0.5}),
        ("position", "position under P control", _ANGLE),
        ("position", "a larger gain", _ANGLE | {"kp": 2.0}),
        ("position", "position, five gains", _without(wide, "kp") | {"seconds": 10.0, "most_overshoot_pct": 10.0}),
        ("position", "position under PD control", wide),
        ("position", "D-15 with a load", wide | {"load_Nm": -0.1}),
        ("position", "D-15 with a stronger load", wide | {"load_Nm": -0.2}),
        ("pid", "PID that removes a load, overshoot 4.3 %", _PID | {"overshoot_pct": 4.3}),
        ("pid", "PID that removes a load, overshoot 2.8 %", _PID | {"overshoot_pct": 2.8}),
    ]
    return {i: Problem(i, *row) for i, row in enumerate(table, start=1)}


PROBLEMS = _all()


def problem(name: str) -> Problem:
    """The problem by its name, ``D-7``, ``d7`` or ``7``. Raises ConfigError naming the nearest one."""
    digits = name.strip().lower().removeprefix("d").removeprefix("-")
    if digits.isascii() and digits.isdigit() and int(digits[:4]) in PROBLEMS:
        return PROBLEMS[int(digits[:4])]
    raise ConfigError(f"unknown problem {name[:40]!r}; they are D-1 to D-{len(PROBLEMS)}")
