"""The text's motor under P, PI and PID control of speed or position, in SI units and continuous time (Fig. D-26).

    L di/dt = v - R i - Kb w,    J dw/dt = Ki i - B w + T,    dtheta/dt = w

with T the text's load torque, which is added: a negative one opposes forward motion. With L = 0 the current follows at
once. The derivative of a controller is that of the angle, which is the speed, or that of the error, as the text's block
takes it (Fig. D-36). That asks for an endless voltage in the moment of a step, of kd times the step in volt seconds,
which puts that over L into the current at once. Solved to nine digits, limits included.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import count
from math import inf, nextafter
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from fiohost.errors import DataError
from fiohost.labs.constants import MotorConstants

FloatArray = NDArray[np.float64]

MOST_RATES = 400_000  # evaluations: far more than any response of the text needs
POINTS = 100_001  # of a response: a crossing between two is found to a part in a million of a time constant
OPEN, SPEED, POSITION = "voltage", "speed", "position"


@dataclass(frozen=True)
class Servo:
    """A motor behind an amplifier, alone or in a loop. *ref* is volts, rad/s or rad, as *controls* says.

    ``v = amplifier (kp (weight ref - sensor y) + ki integral(ref - sensor y) - kd sensor w)``, held within the limits;
    in open loop ``v = amplifier ref``. The load begins at ``load_from_s``; the reference is ``second_ref`` from
    ``second_from_s`` on. A ``weight`` of 0 keeps the step of the
    reference from the proportional part.
    """

    motor: MotorConstants
    ref: float
    controls: str = OPEN
    kp: float = 1.0
    ki: float = 0.0
    kd: float = 0.0
    weight: float = 1.0
    amplifier: float = 1.0
    sensor: float = 1.0
    load_Nm: float = 0.0
    load_from_s: float = 0.0
    limit_V: float = inf
    limit_A: float = inf
    derivative_of_error: bool = False
    second_ref: float = 0.0
    second_from_s: float = inf

    def run(self, duration_s: float) -> Response:
        """The response from rest to a step of the reference at time 0. Raises DataError where it cannot be solved, or
        where a limited voltage is asked for the derivative of a step.
        """
        if self.derivative_of_error and self.kd and self.limit_V < inf:
            raise DataError("the derivative of a step asks for an endless voltage: take that of the angle, or no limit")
        times = np.linspace(0.0, duration_s, POINTS)
        states = np.empty((POINTS, 4))
        state = np.zeros(4)
        left = count(MOST_RATES, -1)

        def rates(time_s: float, state: FloatArray, load_Nm: float, ref: float) -> tuple[float, float, float, float]:
            if next(left) < 0:
                raise DataError(f"this loop is too fast to be followed over {duration_s:g} s: make the run shorter")
            return self._rates(state, load_Nm, ref)

        turns = sorted({0.0, min(self.load_from_s, duration_s), min(self.second_from_s, duration_s), duration_s})
        for begin, end in zip(turns, turns[1:], strict=False):
            load = self.load_Nm if begin >= self.load_from_s else 0.0
            ref = self.second_ref if begin >= self.second_from_s else self.ref
            own = (times >= begin) & (times <= end)
            at = np.unique(np.concatenate((times[own], [end])))
            state = state + self._blow(begin)
            with catch_warnings():
                simplefilter("ignore")  # what they say is in found.message
                found = solve_ivp(rates, (begin, end), state, "LSODA", at, args=(load, ref), rtol=1e-9, atol=1e-12)
            if not found.success or not np.isfinite(found.y).all():
                raise DataError(f"the response cannot be computed: {found.message}")
            states[own] = found.y.T[: int(own.sum())]
            state = found.y[:, -1]
        amps, speed, angle, gathered = states.T
        refs = np.where(times >= self.second_from_s, self.second_ref, self.ref)
        volts: FloatArray = self._volts(speed, angle, gathered, refs)
        if self.motor.L_H == 0.0:
            amps = np.clip((volts - self.motor.Ke_Vs_per_rad * speed) / self.motor.R_ohm, -self.limit_A, self.limit_A)
        return Response(times, np.clip(amps, -self.limit_A, self.limit_A), speed, angle, np.asarray(volts))

    def _blow(self, time_s: float) -> FloatArray:
        """What the derivative of a step of the reference does to the state in that moment."""
        step = (self.ref if time_s == 0.0 else 0.0) + (
            self.second_ref - self.ref if time_s == self.second_from_s else 0.0
        )
        volt_s = self.amplifier * self.kd * step if self.derivative_of_error and self.controls == POSITION else 0.0
        motor = self.motor
        if motor.L_H > 0.0:
            return np.array([volt_s / motor.L_H, 0.0, 0.0, 0.0])
        return np.array([0.0, motor.Kt_Nm_per_A * volt_s / (motor.R_ohm * motor.J_kgm2), 0.0, 0.0])

    def _volts(self, speed: Any, angle: Any, gathered: Any, ref: Any) -> Any:
        """Armature voltage, of numbers or of arrays."""
        if self.controls == OPEN:
            wanted = self.amplifier * ref + 0.0 * speed
        else:
            y = angle if self.controls == POSITION else speed
            wanted = self.kp * (self.weight * ref - self.sensor * y) + self.ki * gathered
            if self.controls == POSITION:
                wanted = wanted - self.kd * self.sensor * speed
            wanted = self.amplifier * wanted
        return np.clip(wanted, -self.limit_V, self.limit_V)

    def _rates(self, state: FloatArray, load_Nm: float, ref: float) -> tuple[float, float, float, float]:
        motor = self.motor
        amps, speed, angle, gathered = state
        volts = float(self._volts(speed, angle, gathered, ref))
        slope = 0.0
        if motor.L_H > 0.0:
            slope = (volts - motor.R_ohm * amps - motor.Ke_Vs_per_rad * speed) / motor.L_H
        else:
            amps = (volts - motor.Ke_Vs_per_rad * speed) / motor.R_ohm
        driven = motor.Kt_Nm_per_A * min(max(amps, -self.limit_A), self.limit_A)
        y = angle if self.controls == POSITION else speed
        faster = (driven - motor.B_Nms * speed + load_Nm) / motor.J_kgm2
        return slope, faster, speed, ref - self.sensor * y


@dataclass(frozen=True)
class Response:
    """Each array (n): seconds, winding current (A), speed (rad/s), angle (rad), armature voltage (V)."""

    time_s: FloatArray
    amps: FloatArray
    speed: FloatArray
    angle: FloatArray
    volts: FloatArray

    def until(self, seconds: float) -> Response:
        """Its beginning."""
        keep = self.time_s <= seconds
        return Response(*(getattr(self, item.name)[keep] for item in fields(self)))

    @property
    def most_amps(self) -> float:
        """The largest current in size, with its sign."""
        return float(self.amps[np.argmax(np.abs(self.amps))])


def reached_s(time_s: FloatArray, y: FloatArray, level: float, begin_s: float = 0.0) -> float | None:
    """When *y* first reaches a level at or after a time, from whichever side it begins; None where it does not."""
    first = int(np.searchsorted(time_s, nextafter(begin_s, -inf)))
    way = (y[first:] - level) * (1.0 if y[first] <= level else -1.0)
    k = int(np.argmax(way >= 0.0))
    if way[k] < 0.0:
        return None
    if k == 0:
        return float(time_s[first])
    share = way[k - 1] / (way[k - 1] - way[k])
    return float(time_s[first + k - 1] + share * (time_s[first + k] - time_s[first + k - 1]))
