"""A model that goes on step by step from where it is, for programs that simulate it among others."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fiohost.errors import DataError
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, Start, run, seen_angle, start_state
from fiohost.motor.state import BRAKE, DRIVE, OMEGA


class Stepper:
    """One motor, at rest at 0 degrees when made. The duty of a step acts from its beginning; 0 brakes."""

    def __init__(self, model: Model | Path) -> None:
        motor = model if isinstance(model, Model) else Model.read(model)
        self._p, self._on, self._substep_s = motor.vector(), motor.switches(), motor.substep_s()
        self._seen = seen_angle(self._p, self._on)
        self._state = start_state(Start(0.0, 0.0), self._p, self._on)
        self._duty, self._mode, self._time_s = 0.0, BRAKE, 0.0

    def step(self, duty_pct: float, seconds: float) -> tuple[float, float]:
        """Angle (deg) and speed (deg/s) after *seconds* of a duty in percent. Raises DataError out of range."""
        if not -100.0 <= duty_pct <= 100.0 or not 0.0 < seconds < 1e6:
            raise DataError(f"a step of {seconds!r} s at a duty of {duty_pct!r} % cannot be made")
        mode = DRIVE if duty_pct else BRAKE
        span = Excitation(
            np.array([0.0, seconds]), np.array([0.0]), np.array([self._duty, duty_pct]),
            np.array([self._mode, mode]), self._time_s,
        )  # fmt: skip
        self._state = run(span, self._p, self._on, self._substep_s, self._state)[-1]
        self._duty, self._mode, self._time_s = duty_pct, mode, self._time_s + seconds
        return float(self._state[self._seen]), float(self._state[OMEGA])
