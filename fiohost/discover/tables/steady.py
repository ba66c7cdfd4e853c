"""Readings at steady operating points: a static curve of speed over duty, current against torque, speed or duty.

A row gives some of duty, load torque and speed; the rest follows from the model run until it is steady. A model is in
percent: amperes and newton metres need the current and the torque of the stalled motor at full duty. The current that
overcomes viscous friction is part of the back-emf of a model, and is told apart by the share it has of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import isfinite

import numpy as np
from scipy.optimize import brentq

from fiohost.control.closed_loop import Plant
from fiohost.discover.tables.settings import SETTINGS
from fiohost.discover.tables.table import Constant, Figure, Row
from fiohost.motor.compiled import compiled
from fiohost.motor.effect import effects, layout
from fiohost.motor.electrics import settled_current
from fiohost.motor.hooks import PERIOD, command
from fiohost.motor.simulate import Excitation, run
from fiohost.motor.state import DRIVE, GAIN, OMEGA, STATE_SIZE, TAU, THETA

# A command that acted before the first sample, and drives all along.
SINCE, DRIVEN = np.array([-1.0]), np.full(2, DRIVE, dtype=np.int64)
LOAD_ON, LOAD = list(effects()).index("constant_load"), layout()["constant_load"]
STALL_CURRENT, STALL_TORQUE, VISCOUS_SHARE = range(3)
CONSTANTS = (
    Constant("stall_current_A", "A", 1.0, 1e-4, 1e5),
    Constant("stall_torque_Nm", "N m", 1.0, 1e-7, 1e6),
    Constant("viscous_share", "", 0.0, 0.0, 0.99),
)


@compiled
def _currents(states, times, duty, p, on, found):  # type: ignore[no-untyped-def]
    """Current in percent of stall at each of the states (n, STATE_SIZE) under a duty."""
    acting = command(duty, (p[PERIOD],), p, on)
    for i in range(states.shape[0]):
        found[i] = settled_current(states[i, OMEGA], times[i], acting, states[i], p, on)


@dataclass(frozen=True)
class Point:
    """What is known of one operating point: duty in percent, load in N m, speed in deg/s; None where it follows."""

    duty_pct: float | None = None
    torque_Nm: float = 0.0
    speed_deg_s: float | None = None


@dataclass(frozen=True)
class Operation:
    """A steady point in the model's units: speed in deg/s, current in percent of stall without its viscous part."""

    speed_deg_s: float
    current_pct: float


def loaded(plant: Plant, load_pct: float) -> Plant:
    """The same motor with a constant torque on it, in percent, beside any that it has."""
    p, on = plant.p.copy(), plant.on.copy()
    p[LOAD] = (p[LOAD] if on[LOAD_ON] else 0.0) + load_pct
    on[LOAD_ON] = True
    return plant._replace(p=p, on=on)


@cache
def _times(samples: int) -> np.ndarray:
    return np.arange(samples) * SETTINGS.step_s


def operate(plant: Plant, duty_pct: float, settle_s: float, average_s: float) -> Operation:
    """Means over ``average_s`` after ``settle_s`` of a constant duty, from rest."""
    before, after = max(round(settle_s / SETTINGS.step_s), 1), max(round(average_s / SETTINGS.step_s), 1)
    p = plant.p.copy()
    p[TAU] = min(p[TAU], settle_s / SETTINGS.lags)  # a motor that has not settled is no steady point, whatever its lag
    times = _times(before + after + 1)
    excitation = Excitation(times, SINCE, np.array([duty_pct, duty_pct]), DRIVEN)
    states = run(excitation, p, plant.on, plant.substep_s, np.zeros(STATE_SIZE))[before:]
    currents = np.empty(len(states))
    _currents(states, times[before:], duty_pct, p, plant.on, currents)
    return Operation(
        float(states[-1, THETA] - states[0, THETA]) / (after * SETTINGS.step_s), float(currents.sum()) / len(currents)
    )


def held(plant: Plant, duty_pct: float, speed_deg_s: float) -> Operation:
    """A shaft that is held at a speed, as one stalled by hand, under a duty."""
    states = np.zeros((1, STATE_SIZE))
    states[0, OMEGA] = speed_deg_s
    currents = np.empty(1)
    _currents(states, np.zeros(1), duty_pct, plant.p, plant.on, currents)
    return Operation(speed_deg_s, float(currents[0]))


@dataclass(frozen=True)
class SteadyReadings:
    """A table of steady operating points; figures are ``speed`` and ``current``."""

    name: str
    figures: Sequence[Figure]
    rows: Sequence[Row]
    points: Sequence[Point]
    constants: Sequence[Constant] = CONSTANTS
    settle_s: float = 2.0
    average_s: float = 1.0

    def predict(self, plant: Plant, row: int, constants: Sequence[float]) -> Mapping[str, float]:
        point = self.points[row]
        load_pct = 100.0 * point.torque_Nm / constants[STALL_TORQUE]
        found = self._operation(loaded(plant, load_pct) if load_pct != 0.0 else plant, point)
        emf_pct = found.speed_deg_s / float(plant.p[GAIN])
        current_pct = found.current_pct + constants[VISCOUS_SHARE] * emf_pct
        values = {"speed": found.speed_deg_s, "current": 0.01 * current_pct * constants[STALL_CURRENT]}
        return {figure.name: values[figure.name] / figure.scale for figure in self.figures}

    def _operation(self, plant: Plant, point: Point) -> Operation:
        if point.duty_pct is not None and point.speed_deg_s is not None:
            return held(plant, point.duty_pct, point.speed_deg_s)
        duty = point.duty_pct if point.duty_pct is not None else self._duty_for(plant, point.speed_deg_s or 0.0)
        return operate(plant, duty, self.settle_s, self.average_s)

    def _duty_for(self, plant: Plant, speed_deg_s: float) -> float:
        """The duty at which the motor runs at a speed; full duty where it cannot."""

        def off(duty_pct: float) -> float:
            return operate(plant, duty_pct, self.settle_s, self.average_s).speed_deg_s - speed_deg_s

        low, high = off(-100.0), off(100.0)
        if not (isfinite(low) and isfinite(high)) or low * high > 0.0:
            return 100.0 if abs(high) < abs(low) else -100.0
        return float(brentq(off, -100.0, 100.0, xtol=1e-3))


def with_values(constants: Sequence[Constant], values: Mapping[str, float], fitted: Sequence[str]) -> list[Constant]:
    """The constants of a bench: some given, some to be fitted, from the given value where there is one."""
    return [replace(c, value=values.get(c.name, c.value), fitted=c.name in fitted) for c in constants]
