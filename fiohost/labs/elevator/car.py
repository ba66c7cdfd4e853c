"""The car: its floors and drum, the constants of its motor, and what the text demands of its moves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import degrees
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fiohost.control.metrics import StepFigures, step_figures
from fiohost.control.settings import ControlSettings
from fiohost.labs.constants import TEXT
from fiohost.labs.session import DERIVATIVE_FILTER_S
from fiohost.motor.model import Model

FloatArray = NDArray[np.float64]

TOP_FLOOR = 6  # the text's seven floors are numbered 0 to 6
FLOOR_CM = 5.0
DRUM_CM = 1.375
DEG_PER_CM = degrees(1.0 / DRUM_CM)
LOAD_NM = 0.017  # Eq. D-34: a car of 124 g on that drum
MOTOR = TEXT["elevator"]

MOST_OVERSHOOT_PCT = 5.0  # section D-2, design criteria
MOST_ERROR_CM = 0.1
MOST_SETTLING_S = 1.0

SHORTEST_MOVE_S = 1.0  # a car that was sent on before has not finished its move


def car_model(*, current_limit_A: float | None = None, B_Nms: float = MOTOR.B_Nms) -> Model:
    """The reduced model of motor and car: table D-11, the car's weight against upward motion."""
    motor = replace(MOTOR, B_Nms=B_Nms)
    return motor.model(current_limit_A=current_limit_A).with_values(
        {"constant_load.level_pct": motor.torque_pct(LOAD_NM)}
    )


def floor_cm(floor: int) -> float:
    """Height of a floor; the ground floor is 0."""
    return FLOOR_CM * floor


def floor_of(height_cm: float) -> int:
    """The floor nearest to a height."""
    return round(height_cm / FLOOR_CM)


@dataclass(frozen=True)
class Design:
    """A controller as the text writes it: gains in V/rad, V/(rad s) and V s/rad, power in percent of the maximum.

    The derivative is that of the car's own movement: that of a step of the demand would be one blow of full power.
    """

    kp_V_per_rad: float
    ki_V_per_rad_s: float = 0.0
    power_pct: float = 100.0
    kd_V_s_per_rad: float = 0.0

    @property
    def label(self) -> str:
        parts = [f"kp {self.kp_V_per_rad:g}"]
        parts += [f"ki {self.ki_V_per_rad_s:g}"] if self.ki_V_per_rad_s else []
        parts += [f"kd {self.kd_V_s_per_rad:g}"] if self.kd_V_s_per_rad else []
        return ", ".join([*parts, f"{self.power_pct:g} % power"] if self.power_pct < 100.0 else parts)

    def settings(self, full_scale_V: float) -> ControlSettings:
        """The same for a bench whose full duty is a voltage. Raises ConfigError for values that make no law."""
        per_deg = 100.0 / full_scale_V / degrees(1.0)
        kp, ki, kd = self.kp_V_per_rad, self.ki_V_per_rad_s, self.kd_V_s_per_rad
        return ControlSettings(
            kind="p" + "i" * bool(ki) + "d" * bool(kd),
            kp_pct_per_deg=kp * per_deg,
            ki_pct_per_deg_s=ki * per_deg,
            kd_pct_s_per_deg=kd * per_deg,
            filter_s=DERIVATIVE_FILTER_S if kd else 0.0,
            derivative_on="angle" if kd else "error",
            limit_pct=self.power_pct,
            tracking_s=kp / ki if ki else 0.0,  # given back as slowly as it integrates: a short limit leaves it alone
        )


class Record(NamedTuple):
    """A run of the car, each array (n): seconds, demanded height and height in cm above its start, duty in percent."""

    time_s: FloatArray
    ref_cm: FloatArray
    height_cm: FloatArray
    duty_pct: FloatArray


class Move(NamedTuple):
    """One move from rest to a new height, with its figures in cm and seconds from the moment it was asked for."""

    begin_s: float
    from_cm: float
    to_cm: float
    figures: StepFigures

    @property
    def way(self) -> str:
        return "up" if self.to_cm > self.from_cm else "down"

    @property
    def floors(self) -> int:
        """How many floors it goes."""
        return abs(floor_of(self.to_cm) - floor_of(self.from_cm))

    @property
    def faults(self) -> list[str]:
        """Which of the text's criteria it fails."""
        return faults_of(self.figures.overshoot_pct, self.figures.steady_state_error, self.figures.settling_5_s)


def faults_of(overshoot_pct: float, error_cm: float, settling_s: float) -> list[str]:
    """Which of the text's criteria these figures fail."""
    judged = {
        "overshoot": overshoot_pct > MOST_OVERSHOOT_PCT,
        "error": abs(error_cm) >= MOST_ERROR_CM,
        "settling": settling_s >= MOST_SETTLING_S,
    }
    return [name for name, fails in judged.items() if fails]


def moves(record: Record) -> Iterator[Move]:
    """The moves of a run. Where the demand changes again within a second, both changes are one move.

    Overshoot is of the response's own final value; rise and settling are of the height that was asked for, with which
    the text's block diagram gives the times of its table D-12.
    """
    changes = np.flatnonzero(np.diff(record.ref_cm)) + 1
    ends = [*changes[1:], len(record.time_s)][: len(changes)]
    begin = None
    for at, end in zip(changes, ends, strict=True):
        begin = at if begin is None else begin
        if record.time_s[end - 1] - record.time_s[at] < SHORTEST_MOVE_S:
            continue
        own, start, to = slice(begin, end), float(record.height_cm[begin]), float(record.ref_cm[at])
        was, begin_s = float(record.ref_cm[begin - 1]), float(record.time_s[begin])
        begin = None
        if to != was:
            times = record.time_s[own] - begin_s
            yield Move(begin_s, was, to, step_figures(times, record.height_cm[own], start, to, True))
