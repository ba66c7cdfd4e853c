"""The same motor under the same PWM, edge by edge, by scipy's solve_ivp at tight tolerance; one body.

Written from the circuit's and the effects' own words, sharing no code with the kernel under test. In each part of a
period the bridge is a voltage and a loss against the current; a current that has met zero stays there while the voltage
less the back-emf does not exceed the loss.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from firmware_model.plants import Plant

STANDBY, DRIVEN = 0, 1
PERIOD_S = 50e-6
Event = Callable[[float, Any], float]


@dataclass(frozen=True)
class Part:
    """What the winding meets: volts, ohms, and volts lost against the current."""

    volts: float
    ohms: Callable[[Any], float]
    lost: float


class EdgeReference:
    """States (angle rad, speed rad/s, current A, winding's warmth K) of a plant at rest at time 0."""

    def __init__(self, plant: Plant, theta: float) -> None:
        self.plant, self.q = plant, plant.effects
        self.x = np.array([theta, 0.0, 0.0, 0.0])
        self.time = 0.0
        self.moving = 0.0  # direction of sliding, 0 held
        self.flowing = 0.0  # direction of the current, 0 blocked
        self.limit = self.q.get("current_limit", {}).get("limit_A", math.inf)
        self.clamped = False

    def hold(self, mode: int, duty: float, periods: int) -> None:
        share = min(abs(duty) / 100.0, 1.0) if mode == DRIVEN else 0.0
        for _ in range(periods):
            start = self.time
            if share > 0.0:
                self.pass_part(self.driven(duty, share), start + share * PERIOD_S)
            if share < 1.0:
                self.pass_part(self.between(mode, duty), start + PERIOD_S)

    # -- the bridge

    def hot(self, x: Any) -> float:
        return self.plant.R_ohm * (1.0 + self.q.get("armature_heating", {}).get("alpha_per_K", 0.0) * float(x[3]))

    def driven(self, duty: float, share: float) -> Part:
        sag = self.q.get("supply_sag", {}).get("source_ohm", 0.0)
        lost = self.q.get("bridge_voltage_drop", {}).get("drop_V", 0.0)
        return Part(math.copysign(self.plant.supply_V, duty), lambda x: self.hot(x) + sag * share, lost)

    def between(self, mode: int, duty: float) -> Part:
        if mode == STANDBY:
            return Part(0.0, lambda x: self.plant.R_ohm, self.plant.supply_V)
        lost = self.q.get("bridge_voltage_drop", {}).get("drop_V", 0.0)
        if "fast_decay" in self.q and mode == DRIVEN:
            lost += self.plant.supply_V + self.q["fast_decay"]["diode_V"]
        return Part(0.0, self.hot, lost)

    # -- torques

    def torque(self, x: Any) -> float:
        """All but dry friction."""
        total = self.plant.Kt_Nm_per_A * float(x[2]) - self.plant.B_Nms * float(x[1])
        if "gravity_load" in self.q:
            g = self.q["gravity_load"]
            total -= g["torque_Nm"] * math.sin(float(x[0]) + g["phase_rad"])
        if "cogging_torque" in self.q:
            g = self.q["cogging_torque"]
            total -= g["torque_Nm"] * math.sin(g["order"] * float(x[0]) + g["phase_rad"])
        return total

    def friction(self, x: Any) -> float:
        level = self.plant.coulomb_Nm
        level += self.q.get("load_dependent_friction", {}).get("ratio", 0.0) * abs(self.plant.Kt_Nm_per_A * float(x[2]))
        if "stribeck_friction" in self.q:
            s = self.q["stribeck_friction"]
            level += s["extra_Nm"] * math.exp(-((float(x[1]) / s["stribeck_speed_rad_s"]) ** 2))
        return level

    # -- time

    def rate(self, part: Part, x: Any) -> list[float]:
        plant = self.plant
        change = 0.0
        if self.flowing != 0.0 and not self.clamped:
            push = part.volts - self.flowing * part.lost - plant.Ke_Vs_per_rad * float(x[1])
            change = (push - part.ohms(x) * float(x[2])) / plant.L_H
        warmth = 0.0
        if "armature_heating" in self.q:
            h = self.q["armature_heating"]
            warmth = (float(x[2]) ** 2 * self.hot(x) * h["thermal_K_per_W"] - float(x[3])) / h["time_constant_s"]
        if self.moving == 0.0:
            return [0.0, 0.0, change, warmth]
        speedup = (self.torque(x) - self.moving * self.friction(x)) / plant.J_kgm2
        return [float(x[1]), speedup, change, warmth]

    def choose(self, part: Part) -> None:
        x = self.x
        push = part.volts - self.plant.Ke_Vs_per_rad * float(x[1])
        if x[2] != 0.0:
            self.flowing = math.copysign(1.0, x[2])
        elif part.lost > 0.0 and abs(push) <= part.lost:
            self.flowing = 0.0
        else:
            self.flowing = math.copysign(1.0, push)
        self.clamped = False
        if abs(x[2]) >= self.limit:
            self.clamped = self.rate(part, x)[2] * float(x[2]) > 0.0
        if x[1] != 0.0:
            self.moving = math.copysign(1.0, x[1])
        elif abs(self.torque(x)) > self.friction(x):
            self.moving = math.copysign(1.0, self.torque(x))
        else:
            self.moving = 0.0

    def pass_part(self, part: Part, end: float) -> None:
        for _ in range(100):
            self.choose(part)
            events: list[Any] = []
            begin = self.time

            def late(value: float, now: float, begin: float = begin) -> float:
                return value + (1e-13 if now == begin else 0.0)

            kinds = []
            if self.moving != 0.0:
                events.append(lambda now, x: late(self.moving * float(x[1]), now))
                kinds.append("stop")
            else:
                events.append(lambda now, x: late(self.friction(x) - abs(self.torque(x)), now))
                kinds.append("start")
            if self.flowing != 0.0 and part.lost > 0.0:
                events.append(lambda now, x: late(self.flowing * float(x[2]), now))
                kinds.append("ends")
            if self.flowing != 0.0 and not self.clamped and self.limit < math.inf:
                events.append(lambda now, x: late(self.limit - abs(float(x[2])), now))
                kinds.append("limit")
            for event in events:
                event.terminal, event.direction = True, -1.0
            result = solve_ivp(
                lambda now, x: self.rate(part, x),
                (begin, end),
                self.x,
                events=events,
                method="DOP853",
                rtol=1e-12,
                atol=1e-14,
            )
            assert result.status >= 0, result.message
            self.x, self.time = result.y[:, -1].copy(), float(result.t[-1])
            if result.status == 0:
                self.time = end
                return
            kind = kinds[next(i for i, times in enumerate(result.t_events) if len(times))]
            if kind == "stop":
                self.x[1] = 0.0
            elif kind == "ends":
                self.x[2] = 0.0
            elif kind == "limit":
                self.x[2] = math.copysign(self.limit, self.x[2])
            else:  # break-away: a nudge beyond, smaller than all that is compared
                self.x[1] = math.copysign(1e-12, self.torque(self.x))
        raise AssertionError("too many events in one part of a period")
