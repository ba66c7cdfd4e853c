"""Discrete position controllers: P and PD with a filtered derivative.

All take the reference and the measured angle in degrees and return a duty in percent, one call per tick. After
each step the loop tells the controller what was really applied (``applied``): P and PD have nothing to wind up, a
controller with an integrator corrects itself there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Protocol

from fiohost.errors import ConfigError


class Controller(Protocol):
    """One tick at a time; ``gains`` are the settings that a log should name, units in the keys."""

    @property
    def gains(self) -> Mapping[str, float]: ...

    def reset(self) -> None:
        """Forget the past: the next step is the first of a run."""

    def step(self, ref_deg: float, angle_deg: float) -> float:
        """Wanted duty in percent, not yet limited."""

    def applied(self, duty_pct: float) -> None:
        """What of the wanted duty was really applied, after the limits."""


class P:
    """``u = kp (r - y)``, the lab's C(s) = 1 with kp = 1 %/deg."""

    def __init__(self, kp_pct_per_deg: float) -> None:
        self.kp = _finite("kp_pct_per_deg", kp_pct_per_deg)

    @property
    def gains(self) -> Mapping[str, float]:
        return {"kp_pct_per_deg": self.kp}

    def reset(self) -> None:
        pass

    def step(self, ref_deg: float, angle_deg: float) -> float:
        return self.kp * (ref_deg - angle_deg)

    def applied(self, duty_pct: float) -> None:
        pass


class PD:
    """``u = kp e + kd s/(1 + filter s) e``, the derivative by backward difference.

    ``filter_s`` smooths the steps of the encoder (a count in one tick is 100 deg/s at 0.5 deg and 5 ms); 0 means none.
    With ``on_angle`` only the angle is differentiated, so that a step of the reference gives no kick.
    """

    def __init__(
        self,
        kp_pct_per_deg: float,
        kd_pct_s_per_deg: float,
        sample_time_s: float,
        filter_s: float = 0.0,
        on_angle: bool = False,
    ) -> None:
        self.kp = _finite("kp_pct_per_deg", kp_pct_per_deg)
        self.kd = _finite("kd_pct_s_per_deg", kd_pct_s_per_deg)
        self.filter_s = _finite("filter_s", filter_s)
        if self.filter_s < 0.0 or not sample_time_s > 0.0:
            raise ConfigError("a PD controller needs filter_s of 0 or more and a sample time above 0")
        self.sample_time_s = sample_time_s
        self.on_angle = on_angle
        self._keep = self.filter_s / (self.filter_s + sample_time_s)
        self._new = 1.0 / (self.filter_s + sample_time_s)
        self._before: float | None = None
        self._slope = 0.0

    @property
    def gains(self) -> Mapping[str, float]:
        return {"kp_pct_per_deg": self.kp, "kd_pct_s_per_deg": self.kd, "filter_s": self.filter_s}

    def reset(self) -> None:
        self._before, self._slope = None, 0.0

    def step(self, ref_deg: float, angle_deg: float) -> float:
        error = ref_deg - angle_deg
        signal = -angle_deg if self.on_angle else error
        change = 0.0 if self._before is None else signal - self._before  # no kick from the first reading
        self._before = signal
        self._slope = self._keep * self._slope + self._new * change
        return self.kp * error + self.kd * self._slope

    def applied(self, duty_pct: float) -> None:
        pass


def _finite(name: str, value: float) -> float:
    if not math.isfinite(value):
        raise ConfigError(f"{name} = {value!r} is not a finite number")
    return float(value)
