"""The same machine solved again, slowly: scipy's solve_ivp with event location at tight tolerance.

Written from the equations in the effects' own words, sharing no code with the kernel under test. One body or two with a
rigid gap; regimes (held, sliding, in contact) are chosen from torques at each event.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from firmware_model.plants import Plant

STANDBY = 0
TOLERANCE = {"rtol": 1e-11, "atol": 1e-12, "method": "DOP853"}


class Reference:
    """Angles of a plant at rest at time 0, driven by duties held for ``span_s`` each."""

    def __init__(self, plant: Plant, theta: float, load_theta: float, tolerance: dict[str, Any] | None = None) -> None:
        self.plant = plant
        self.tolerance = {**TOLERANCE, **(tolerance or {})}
        self.q = plant.effects
        gap = self.q.get("backlash", {})
        self.half = 0.5 * gap.get("gap_rad", 0.0)
        self.load_j = gap.get("load_inertia_kgm2", 0.0)
        self.after = gap.get("side") == "encoder_after_gap" and self.half > 0.0
        self.x = np.array([theta, 0.0, 0.0, load_theta, 0.0])
        self.contact = 0
        self.duty = 0.0
        self.mode = STANDBY

    # -- laws

    def effective(self, duty: float) -> float:
        if "input_deadband" in self.q:
            duty = math.copysign(max(abs(duty) - self.q["input_deadband"]["level_pct"], 0.0), duty)
        if "voltage_saturation" in self.q:
            limit = self.q["voltage_saturation"]["limit_pct"]
            duty = max(-limit, min(limit, duty))
        return duty

    def current(self, x: np.ndarray) -> float:
        if self.mode == STANDBY:
            return float(x[2]) if self.plant.L_H > 0.0 else 0.0
        if self.plant.L_H > 0.0:
            return float(x[2])
        return (self.duty / 100.0 * self.plant.supply_V - self.plant.Ke_Vs_per_rad * float(x[1])) / self.plant.R_ohm

    def current_rate(self, x: np.ndarray) -> float:
        plant = self.plant
        if plant.L_H <= 0.0:
            return 0.0
        if self.mode == STANDBY:
            if x[2] == 0.0:
                return 0.0
            volts = -math.copysign(plant.supply_V, self.flow)
        else:
            volts = self.duty / 100.0 * plant.supply_V
        return float((volts - plant.R_ohm * x[2] - plant.Ke_Vs_per_rad * x[1]) / plant.L_H)

    def motor_torque(self, x: np.ndarray) -> float:
        return self.plant.Kt_Nm_per_A * self.current(x) - self.plant.B_Nms * float(x[1])

    def load_torque(self, theta: float) -> float:
        torque = 0.0
        if "constant_load" in self.q:
            torque -= self.q["constant_load"]["torque_Nm"]
        if "gravity_load" in self.q:
            g = self.q["gravity_load"]
            torque -= g["torque_Nm"] * math.sin(theta + g["phase_rad"])
        return torque

    def dry(self) -> float:
        return self.plant.coulomb_Nm

    # -- one body

    def one(self, x: np.ndarray) -> float:
        return self.motor_torque(x) + self.load_torque(float(x[0]))

    def run_one(self, end: float, t: float) -> None:
        forced = 0.0
        for _ in range(10000):
            x = self.x
            if forced:
                side = forced
            elif x[1] != 0.0:
                side = math.copysign(1.0, x[1])
            else:
                torque = self.one(x)
                side = math.copysign(1.0, torque) if abs(torque) > self.dry() else 0.0

            def rate(_t: float, s: np.ndarray, side: float = side) -> list[float]:
                if side == 0.0:
                    return [0.0, 0.0, self.current_rate(s), 0.0, 0.0]
                return [s[1], (self.one(s) - side * self.dry()) / self.plant.J_kgm2, self.current_rate(s), 0.0, 0.0]

            if side == 0.0:
                events = [lambda _t, s: abs(self.one(s)) - self.dry()]
            else:
                events = [lambda _t, s, side=side, start=t: s[1] * side + (1e-14 if _t == start else 0.0)]
            t, which = self.solve(rate, events, t, end)
            if which == 0 and side != 0.0:
                self.x[1] = 0.0
            forced = math.copysign(1.0, self.one(self.x)) if which == 0 and side == 0.0 else 0.0
            if self.half > 0.0:
                self.x[3] = min(max(self.x[3], self.x[0] - self.half), self.x[0] + self.half)
            if t >= end:
                return
        raise AssertionError("too many events")

    # -- two bodies

    def run_two(self, end: float, t: float) -> None:
        plant, load_j = self.plant, self.load_j
        motor_j = plant.J_kgm2 - load_j
        c = self.dry()
        forced = 0.0
        for _ in range(10000):
            x = self.x

            def apart(s: np.ndarray, side: float) -> tuple[float, float]:
                motor = 0.0 if side == 0.0 else (self.motor_torque(s) - side * c) / motor_j
                return motor, self.load_torque(float(s[3])) / load_j

            torque = self.motor_torque(x)
            side = math.copysign(1.0, x[1]) if x[1] != 0.0 else (math.copysign(1.0, torque) if abs(torque) > c else 0.0)
            if self.contact:
                a, b = apart(x, side)
                if (a - b) * self.contact < 0.0:
                    self.contact = 0
            if forced:
                side = forced
            elif self.contact and x[1] == 0.0:
                both = torque + self.load_torque(float(x[3]))
                side = math.copysign(1.0, both) if abs(both) > c else 0.0
            contact = self.contact
            start = t

            def rate(_t: float, s: np.ndarray, side: float = side, contact: int = contact) -> list[float]:
                if contact:
                    both = self.motor_torque(s) + self.load_torque(float(s[3])) - side * c
                    a = b = 0.0 if side == 0.0 else both / plant.J_kgm2
                else:
                    a, b = apart(s, side)
                return [s[1], a, self.current_rate(s), s[4], b]

            events: list[Callable[..., float]] = []
            if side == 0.0:
                extra = (lambda s: self.load_torque(float(s[3]))) if contact else (lambda s: 0.0)
                events.append(lambda _t, s, extra=extra: abs(self.motor_torque(s) + extra(s)) - c)
            else:
                events.append(lambda _t, s, side=side, start=start: s[1] * side + (1e-14 if _t == start else 0.0))
            if contact:

                def pull(_t: float, s: np.ndarray, side: float = side, contact: int = contact) -> float:
                    a, b = apart(s, side)
                    return (a - b) * contact + 1e-12  # never exactly none, or a rest would be an event

                events.append(pull)
            else:
                for face in (1.0, -1.0):
                    near = (x[0] - x[3]) * face > self.half - 1e-9

                    def wall(
                        _t: float, s: np.ndarray, face: float = face, near: bool = near, start: float = start
                    ) -> float:
                        if near and _t == start:
                            return 1.0
                        return self.half - face * float(s[0] - s[3])

                    events.append(wall)
            t, which = self.solve(rate, events, t, end)
            forced = 0.0
            if which == 0 and side == 0.0:
                alone = self.motor_torque(self.x)
                forced = math.copysign(1.0, alone + (self.load_torque(float(self.x[3])) if contact else 0.0))
            if which == 0 and side != 0.0:
                self.x[1] = 0.0
                if contact:
                    self.x[4] = 0.0
            if which >= 1 and not contact:
                self.contact = 1 if which == 1 else -1
                common = (motor_j * self.x[1] + load_j * self.x[4]) / plant.J_kgm2
                self.x[1] = self.x[4] = common
            if which == 1 and contact:
                self.contact = 0
            if self.contact:
                self.x[3] = self.x[0] - self.contact * self.half
                self.x[4] = self.x[1]
            if t >= end:
                return
        raise AssertionError("too many events")

    # -- time

    def solve(self, rate: Any, events: list[Any], t: float, end: float) -> tuple[float, int]:
        if self.plant.L_H > 0.0 and self.mode == STANDBY and self.x[2] != 0.0:
            self.flow = float(self.x[2])
            events = [*events, lambda _t, s, flow=self.flow: s[2] * math.copysign(1.0, flow)]
            diode = len(events) - 1
        else:
            diode = -1
        for event in events:
            event.terminal = True
            event.direction = 0.0
        for i, event in enumerate(events):
            # Held bodies start where their torque grows beyond the hold; all other events are falls through zero.
            event.direction = (
                1.0 if i == 0 and rate(t, self.x)[0] == 0.0 and self.x[1] == 0.0 and event(t, self.x) < 0 else -1.0
            )
        result = solve_ivp(rate, (t, end), self.x, events=events, max_step=0.02, **self.tolerance)
        assert result.status >= 0, result.message
        self.x = result.y[:, -1].copy()
        if result.status == 0:
            return end, -1
        which = next(i for i, times in enumerate(result.t_events) if len(times))
        if which == diode:
            self.x[2] = 0.0
            return float(result.t[-1]), -2
        return float(result.t[-1]), which

    def angles(self, modes: np.ndarray, duties: np.ndarray, span_s: float) -> np.ndarray:
        """Angle at the encoder's disc in degrees before each hold and after the last, (n + 1,)."""
        delay = self.q.get("transport_delay", {}).get("delay_s", 0.0)
        times = np.arange(len(duties) + 1) * span_s
        act = times[:-1] + delay
        seen = []
        j = 0
        for k in range(len(duties) + 1):
            seen.append(math.degrees(self.x[3] if self.after else self.x[0]))
            if k == len(duties):
                break
            now = float(times[k])
            while now < times[k + 1]:
                while j < len(act) and act[j] <= now:
                    self.mode, self.duty = int(modes[j]), self.effective(float(duties[j]))
                    j += 1
                until = min(float(times[k + 1]), float(act[j]) if j < len(act) else math.inf)
                (self.run_two if self.load_j > 0.0 else self.run_one)(until, now)
                now = until
        return np.array(seen)
