"""Discrete position controllers: P, PD, PI and PID, the derivative filtered, the integral safe from winding up.

The angle that they are given does not jump at 0 and 360 degrees. All take the reference and the measured angle in
degrees and return a duty in percent, one call per tick. After each step the loop tells the controller what was really
applied (``applied``): P and PD have nothing to wind up, a controller with an integral corrects itself there.
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


class PID(PD):
    """PD with an integral by backward difference, ``ki tick sum(e)``.

    Where the limit cuts the duty, the integral gives the excess back within about ``tracking_s`` (back-calculation;
    Astrom and Hagglund, Advanced PID Control, section 3.5), at once for 0: it does not wind up. It gives no more than
    it holds: an excess of the proportional part alone would wind it up the other way.
    """

    def __init__(
        self,
        kp_pct_per_deg: float,
        ki_pct_per_deg_s: float,
        kd_pct_s_per_deg: float,
        sample_time_s: float,
        filter_s: float = 0.0,
        on_angle: bool = False,
        tracking_s: float = 0.0,
    ) -> None:
        super().__init__(kp_pct_per_deg, kd_pct_s_per_deg, sample_time_s, filter_s, on_angle)
        self.ki = _finite("ki_pct_per_deg_s", ki_pct_per_deg_s)
        self.tracking_s = _finite("tracking_s", tracking_s)
        if self.tracking_s < 0.0:
            raise ConfigError("a controller with an integral needs tracking_s of 0 or more")
        self._returned = sample_time_s / max(self.tracking_s, sample_time_s)
        self._integral = self._wanted = 0.0

    @property
    def gains(self) -> Mapping[str, float]:
        return {**super().gains, "ki_pct_per_deg_s": self.ki, "tracking_s": self.tracking_s}

    def reset(self) -> None:
        super().reset()
        self._integral = self._wanted = 0.0

    def step(self, ref_deg: float, angle_deg: float) -> float:
        self._integral += self.ki * self.sample_time_s * (ref_deg - angle_deg)
        self._wanted = super().step(ref_deg, angle_deg) + self._integral
        return self._wanted

    def applied(self, duty_pct: float) -> None:
        if self.ki == 0.0:
            return
        back = self._returned * (duty_pct - self._wanted)
        held = self._integral
        self._integral = max(held + back, min(held, 0.0)) if back < 0.0 else min(held + back, max(held, 0.0))


class PI(PID):
    """A PID without a derivative."""

    def __init__(
        self, kp_pct_per_deg: float, ki_pct_per_deg_s: float, sample_time_s: float, tracking_s: float = 0.0
    ) -> None:
        super().__init__(kp_pct_per_deg, ki_pct_per_deg_s, 0.0, sample_time_s, tracking_s=tracking_s)

    @property
    def gains(self) -> Mapping[str, float]:
        return {"kp_pct_per_deg": self.kp, "ki_pct_per_deg_s": self.ki, "tracking_s": self.tracking_s}


def _finite(name: str, value: float) -> float:
    if not math.isfinite(value):
        raise ConfigError(f"{name} = {value!r} is not a finite number")
    return float(value)
