"""What drives without a hand on the slider: steps, sines and squares of the duty, or of a controller's set point."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from fiohost.control.controllers import PID
from fiohost.control.law import ControlLaw
from fiohost.errors import LimitError
from fiohost.settings import nearest

SHAPES = ("hold", "step", "sine", "square")
KINDS = ("p", "pd", "pi", "pid")
MOST_DEG = 36_000.0  # a hundred turns
PERIODS_S = (0.05, 1000.0)
GAIN = 1e4
FILTER_S, TRACKING_S = 0.01, 0.5  # of the derivative; in which an integral at the limit gives back


@dataclass(frozen=True)
class Source:
    """A signal over time: ``hold`` the offset, ``step`` from it by the amplitude after half a period, ``sine`` and
    ``square`` about it.
    """

    shape: str
    amplitude: float
    offset: float
    period_s: float

    @classmethod
    def read(cls, told: Mapping[str, object], most: float) -> Source:
        """From a message; amplitude and offset together stay within ``most``. Raises LimitError."""
        shape = told.get("shape", "hold")
        if shape not in SHAPES:
            raise LimitError(f"unknown shape {str(shape)[:20]!r}; {nearest(str(shape)[:20], SHAPES)}")
        amplitude, offset = number(told, "amplitude", 0.0, most), number(told, "offset", 0.0, most)
        if abs(amplitude) + abs(offset) > most:
            raise LimitError(f"amplitude and offset together are beyond {most:g}")
        period_s = number(told, "period_s", 1.0, PERIODS_S[1])
        if period_s < PERIODS_S[0]:
            raise LimitError(f"period_s = {period_s:g} is below {PERIODS_S[0]:g} s")
        return cls(str(shape), amplitude, offset, period_s)

    def at(self, time_s: float) -> float:
        """The value so many seconds after its begin."""
        if self.shape == "step":
            return self.offset + (self.amplitude if time_s >= 0.5 * self.period_s else 0.0)
        turn = time_s / self.period_s
        if self.shape == "sine":
            return self.offset + self.amplitude * math.sin(2.0 * math.pi * turn)
        if self.shape == "square":
            return self.offset + (self.amplitude if turn % 1.0 < 0.5 else -self.amplitude)
        return self.offset


class Loop:
    """A controller whose set point follows a source, and whose gains may change while it runs."""

    def __init__(self, told: Mapping[str, object], sample_time_s: float, limit_pct: float) -> None:
        """Raises LimitError."""
        self._pid = PID(0.0, 0.0, 0.0, sample_time_s, FILTER_S, on_angle=True, tracking_s=TRACKING_S)
        self._law = ControlLaw(self._pid, limit_pct=limit_pct)
        self.change(told)

    def change(self, told: Mapping[str, object]) -> None:
        """New gains or another set point; the integral keeps what it holds. Raises LimitError, and changes nothing."""
        kind = told.get("kind", "p")
        if kind not in KINDS:
            raise LimitError(f"unknown controller {str(kind)[:20]!r}; {nearest(str(kind)[:20], KINDS)}")
        source = Source.read(told, MOST_DEG)
        kp, ki, kd = (number(told, key, 0.0, GAIN) for key in ("kp", "ki", "kd"))
        self.kind, self.source = str(kind), source
        self._pid.kp = kp
        self._pid.ki = ki if "i" in self.kind else 0.0
        self._pid.kd = kd if "d" in self.kind else 0.0

    def step(self, time_s: float, angle_deg: float) -> tuple[float, float]:
        """Duty in percent and reference in degrees."""
        ref = self.source.at(time_s)
        return self._law.step(ref, angle_deg), ref


def number(told: Mapping[str, object], key: str, default: float, most: float) -> float:
    """A finite number of a message within +-``most``. Raises LimitError."""
    value = told.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not -most <= value <= most:
        raise LimitError(f"{key} needs a number within {most:g}, not {str(value)[:40]!r}")
    return float(value)
