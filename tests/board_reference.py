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
TOLERANCE = {"rtol": 1e-12, "atol": 1e-13, "method": "DOP853"}


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
        spring = self.q.get("shaft_compliance", {})
        self.stiffness = spring.get("stiffness_Nm_per_rad", 0.0)
        self.damping = spring.get("damping_Nms", 0.0)
        self.load_j = max(self.load_j, spring.get("load_inertia_kgm2", 0.0))
        self.after = self.after or spring.get("side") == "encoder_after_spring"
        self.henry = max(plant.L_H, self.q.get("armature_inductance", {}).get("inductance_H", 0.0))
        self.changed = False
        self.stopped = False
        self.flow = 0.0
        # Angle, speed, current, load's angle and speed, bristle, winding's warmth, friction's warmth.
        self.x = np.array([theta, 0.0, 0.0, load_theta, 0.0, 0.0, 0.0, 0.0])
        self.contact = 0
        self.duty = 0.0
        self.mode = STANDBY

    # -- laws

    def effective(self, duty: float) -> float:
        q, size, sign = self.q, abs(duty), math.copysign(1.0, duty)
        if "pwm_resolution" in q:
            levels = q["pwm_resolution"]["levels"]
            size = math.floor(size / 100.0 * levels + 0.5) * 100.0 / levels
        if "duty_curve" in q:
            size = 100.0 * (size / 100.0) ** q["duty_curve"]["exponent"]
        if "input_deadband" in q:
            size = max(size - q["input_deadband"]["level_pct"], 0.0)
        if "asymmetric_deadband" in q:
            key = "u_plus_pct" if sign > 0.0 else "u_minus_pct"
            size = max(size - abs(q["asymmetric_deadband"][key]), 0.0)
        if "pwm_dead_time" in q and size < 100.0:
            size = max(size - 100.0 * q["pwm_dead_time"]["time_s"] / 50e-6, 0.0)
        if "voltage_saturation" in q:
            size = min(size, q["voltage_saturation"]["limit_pct"])
        return sign * size

    def change(self, which: str) -> float:
        change = self.q.get("parameter_change")
        return float(change["ratio"]) if self.changed and change is not None and change["which"] == which else 1.0

    def volts(self, t: float) -> float:
        volts = self.duty / 100.0 * self.plant.supply_V
        volts *= 1.0 + self.q.get("supply_drift", {}).get("drift_per_s", 0.0) * t
        if self.duty < 0.0:
            volts *= self.q.get("direction_dependent_gain", {}).get("ratio", 1.0)
        return volts * self.change("gain")

    def ohms(self, x: np.ndarray) -> float:
        sag = self.q.get("supply_sag", {}).get("source_ohm", 0.0) * (self.duty / 100.0) ** 2
        return self.hot(x) + sag

    def hot(self, x: np.ndarray) -> float:
        return self.plant.R_ohm * (1.0 + self.q.get("armature_heating", {}).get("alpha_per_K", 0.0) * float(x[6]))

    def current(self, t: float, x: np.ndarray) -> float:
        limit = self.q.get("current_limit", {}).get("limit_A", math.inf)
        if self.henry > 0.0:
            return max(-limit, min(limit, float(x[2])))
        if self.mode == STANDBY:
            return 0.0
        push = self.volts(t) - self.plant.Ke_Vs_per_rad * float(x[1])
        lost = self.q.get("bridge_voltage_drop", {}).get("drop_V", 0.0)
        push = math.copysign(max(abs(push) - lost, 0.0), push)
        return max(-limit, min(limit, push / self.ohms(x)))

    def current_rate(self, t: float, x: np.ndarray) -> float:
        plant = self.plant
        if self.henry <= 0.0:
            return 0.0
        if self.mode == STANDBY:
            if x[2] == 0.0:
                return 0.0
            volts = -math.copysign(plant.supply_V, self.flow)
            return float((volts - plant.R_ohm * x[2] - plant.Ke_Vs_per_rad * x[1]) / self.henry)
        if self.flow == 0.0:
            return 0.0
        limit = self.q.get("current_limit", {}).get("limit_A", math.inf)
        current = max(-limit, min(limit, float(x[2])))
        push = self.push(t, x) - math.copysign(self.lost, self.flow) - self.ohms(x) * current
        return 0.0 if abs(current) == limit and push * current > 0.0 else push / self.henry

    @property
    def lost(self) -> float:
        return float(self.q.get("bridge_voltage_drop", {}).get("drop_V", 0.0))

    def push(self, t: float, x: np.ndarray) -> float:
        return self.volts(t) - self.plant.Ke_Vs_per_rad * float(x[1])

    def motor_torque(self, t: float, x: np.ndarray) -> float:
        torque = self.plant.Kt_Nm_per_A * self.current(t, x) - self.plant.B_Nms * float(x[1])
        torque -= self.q.get("quadratic_drag", {}).get("drag_Nms2", 0.0) * float(x[1] * abs(x[1]))
        if "cogging_torque" in self.q:
            g = self.q["cogging_torque"]
            torque -= g["torque_Nm"] * math.sin(g["order"] * x[0] + g["phase_rad"])
        if self.stiffness > 0.0:
            torque -= self.stiffness * float(x[0] - x[3]) + self.damping * float(x[1] - x[4])
        if "presliding_friction" in self.q:
            side = math.copysign(1.0, x[5]) if x[5] else 0.0
            torque -= self.level(t, x, side) * float(x[5]) / self.q["presliding_friction"]["breakaway_rad"]
        return torque

    def load_torque(self, x: np.ndarray) -> float:
        torque = 0.0
        if "constant_load" in self.q:
            torque -= self.q["constant_load"]["torque_Nm"]
        if "gravity_load" in self.q:
            g = self.q["gravity_load"]
            torque -= g["torque_Nm"] * math.sin(float(x[3] if self.load_j > 0.0 else x[0]) + g["phase_rad"])
        if self.stiffness > 0.0:
            torque += self.stiffness * float(x[0] - x[3]) + self.damping * float(x[1] - x[4])
        return torque

    def level(self, t: float, x: np.ndarray, side: float) -> float:
        """Sliding friction towards ``side``."""
        q, c = self.q, self.plant.coulomb_Nm
        if "asymmetric_coulomb_friction" in q:
            a = q["asymmetric_coulomb_friction"]
            c += a["forward_Nm"] if side > 0.0 else a["reverse_Nm"]
        if "stribeck_friction" in q:
            st = q["stribeck_friction"]
            c += st["extra_Nm"] * math.exp(-((float(x[1]) / st["stribeck_speed_rad_s"]) ** 2))
        if "load_dependent_friction" in q:
            c += q["load_dependent_friction"]["ratio"] * self.plant.Kt_Nm_per_A * abs(self.current(t, x))
        if "position_dependent_friction" in q:
            g = q["position_dependent_friction"]
            c *= 1.0 + g["ratio"] * math.sin(g["order"] * float(x[0]) + g["phase_rad"])
        if "friction_warm_up" in q:
            c *= 1.0 - q["friction_warm_up"]["ratio"] * float(x[7])
        return c * self.change("friction")

    def sliding(self, t: float, x: np.ndarray, side: float) -> float:
        return 0.0 if side == 0.0 or "presliding_friction" in self.q else side * self.level(t, x, side)

    def beyond(self, t: float, x: np.ndarray, torque: float) -> float:
        """How far a torque goes beyond what holds the motor at rest; negative: held."""
        if "presliding_friction" in self.q:
            return abs(torque)
        side = math.copysign(1.0, torque)
        if self.stopped and side * self.q["hard_stop"]["angle_rad"] > 0.0:
            return -1.0
        return abs(torque) - self.level(t, x, side) - self.q.get("static_friction", {}).get("extra_Nm", 0.0)

    def slow(self, t: float, x: np.ndarray, side: float) -> list[float]:
        """Rates of bristle, winding's warmth and friction's warmth."""
        bristle = warmth = run_in = 0.0
        if "presliding_friction" in self.q:
            bristle = float(x[1]) * (1.0 - side * float(x[5]) / self.q["presliding_friction"]["breakaway_rad"])
        if "armature_heating" in self.q:
            h = self.q["armature_heating"]
            loss = self.current(t, x) ** 2 * self.hot(x)
            warmth = (loss * h["thermal_K_per_W"] - float(x[6])) / h["time_constant_s"]
        if "friction_warm_up" in self.q:
            run_in = ((side != 0.0) - float(x[7])) / self.q["friction_warm_up"]["time_constant_s"]
        return [bristle, warmth, run_in]

    # -- one body

    def one(self, t: float, x: np.ndarray) -> float:
        return self.motor_torque(t, x) + self.load_torque(x)

    def run_one(self, end: float, t: float) -> None:
        forced = 0.0
        stop = self.q.get("hard_stop", {}).get("angle_rad", math.inf)
        way = math.copysign(1.0, stop)
        inertia = self.plant.J_kgm2 * self.change("inertia")
        for _ in range(10000):
            x = self.x
            if forced:
                side = forced
            elif x[1] != 0.0:
                side = math.copysign(1.0, x[1])
            else:
                torque = self.one(t, x)
                if torque == 0.0 and "presliding_friction" in self.q:
                    torque = self.duty  # the current, and with it the torque, is about to rise
                side = math.copysign(1.0, torque) if self.beyond(t, x, torque) > 0.0 else 0.0
            if side:
                self.stopped = False

            def rate(now: float, s: np.ndarray, side: float = side) -> list[float]:
                if side == 0.0:
                    return [0.0, 0.0, self.current_rate(now, s), 0.0, 0.0, *self.slow(now, s, side)]
                speedup = (self.one(now, s) - self.sliding(now, s, side)) / inertia
                return [s[1], speedup, self.current_rate(now, s), 0.0, 0.0, *self.slow(now, s, side)]

            if side == 0.0:
                events = [lambda now, s: self.beyond(now, s, self.one(now, s))]
            else:
                events = [lambda now, s, side=side, start=t: s[1] * side + (1e-14 if now == start else 0.0)]
            if not self.stopped and abs(stop) < math.inf:
                events.append(lambda _t, s: way * float(stop - s[0]))
            t, which = self.solve(rate, events, t, end)
            if which == 0 and side != 0.0:
                self.x[1] = 0.0
            if which == 1:
                self.x[0], self.x[1], self.stopped = stop, 0.0, True
            forced = math.copysign(1.0, self.one(t, self.x)) if which == 0 and side == 0.0 else 0.0
            if self.half > 0.0:
                self.x[3] = min(max(self.x[3], self.x[0] - self.half), self.x[0] + self.half)
            if t >= end:
                return
        raise AssertionError("too many events")

    def run_spring(self, end: float, t: float) -> None:
        """Two bodies on a spring; the load without friction of its own."""
        ratio = self.change("inertia")
        load_j = self.load_j * ratio
        motor_j = self.plant.J_kgm2 * ratio - load_j
        forced = 0.0
        for _ in range(10000):
            x = self.x
            torque = self.motor_torque(t, x)
            side = math.copysign(1.0, x[1]) if x[1] else 0.0
            if not side and self.beyond(t, x, torque) > 0.0:
                side = math.copysign(1.0, torque)
            side = forced or side

            def rate(now: float, s: np.ndarray, side: float = side) -> list[float]:
                a = 0.0 if side == 0.0 else (self.motor_torque(now, s) - self.sliding(now, s, side)) / motor_j
                moving = [s[1] if side else 0.0, a, self.current_rate(now, s)]
                return [*moving, s[4], self.load_torque(s) / load_j, *self.slow(now, s, side)]

            if side == 0.0:
                events = [lambda now, s: self.beyond(now, s, self.motor_torque(now, s))]
            else:
                events = [lambda now, s, side=side, start=t: s[1] * side + (1e-14 if now == start else 0.0)]
            t, which = self.solve(rate, events, t, end)
            if which == 0 and side != 0.0:
                self.x[1] = 0.0
            forced = math.copysign(1.0, self.motor_torque(t, self.x)) if which == 0 and side == 0.0 else 0.0
            if t >= end:
                return
        raise AssertionError("too many events")

    # -- two bodies

    def run_two(self, end: float, t: float) -> None:
        plant, load_j = self.plant, self.load_j
        motor_j = plant.J_kgm2 - load_j
        c = self.plant.coulomb_Nm
        forced = 0.0
        for _ in range(10000):
            x = self.x

            def apart(now: float, s: np.ndarray, side: float) -> tuple[float, float]:
                motor = 0.0 if side == 0.0 else (self.motor_torque(now, s) - side * c) / motor_j
                return motor, self.load_torque(s) / load_j

            torque = self.motor_torque(t, x)
            side = math.copysign(1.0, x[1]) if x[1] != 0.0 else (math.copysign(1.0, torque) if abs(torque) > c else 0.0)
            if self.contact:
                a, b = apart(t, x, side)
                if (a - b) * self.contact < 0.0:
                    self.contact = 0
            if forced:
                side = forced
            elif self.contact and x[1] == 0.0:
                both = torque + self.load_torque(x)
                side = math.copysign(1.0, both) if abs(both) > c else 0.0
            contact = self.contact
            start = t

            def rate(now: float, s: np.ndarray, side: float = side, contact: int = contact) -> list[float]:
                if contact:
                    both = self.motor_torque(now, s) + self.load_torque(s) - side * c
                    a = b = 0.0 if side == 0.0 else both / plant.J_kgm2
                else:
                    a, b = apart(now, s, side)
                return [s[1], a, self.current_rate(now, s), s[4], b, 0.0, 0.0, 0.0]

            events: list[Callable[..., float]] = []
            if side == 0.0:
                extra = (lambda s: self.load_torque(s)) if contact else (lambda s: 0.0)
                events.append(lambda now, s, extra=extra: abs(self.motor_torque(now, s) + extra(s)) - c)
            else:
                events.append(lambda now, s, side=side, start=start: s[1] * side + (1e-14 if now == start else 0.0))
            if contact:

                def pull(now: float, s: np.ndarray, side: float = side, contact: int = contact) -> float:
                    a, b = apart(now, s, side)
                    return (a - b) * contact + 1e-12  # never exactly none, or a rest would be an event

                events.append(pull)
            else:
                for face in (1.0, -1.0):
                    near = (x[0] - x[3]) * face > self.half - 1e-9

                    def wall(
                        now: float, s: np.ndarray, face: float = face, near: bool = near, start: float = start
                    ) -> float:
                        if near and now == start:
                            return 1.0
                        return self.half - face * float(s[0] - s[3])

                    events.append(wall)
            t, which = self.solve(rate, events, t, end)
            forced = 0.0
            if which == 0 and side == 0.0:
                alone = self.motor_torque(t, self.x)
                forced = math.copysign(1.0, alone + (self.load_torque(self.x) if contact else 0.0))
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
        self.flow = float(self.x[2])
        diode = len(events)
        if self.henry > 0.0 and self.mode != STANDBY and self.flow == 0.0:
            self.flow = self.push(t, self.x) if self.lost == 0.0 or abs(self.push(t, self.x)) > self.lost else 0.0
            if self.flow == 0.0 and self.lost > 0.0:
                events = [*events, lambda now, y: self.lost - abs(self.push(now, y)) + 1e-12]
            elif self.flow == 0.0:
                self.flow = 1.0
        if self.henry > 0.0 and self.flow != 0.0 and (self.mode == STANDBY or self.lost > 0.0):
            way = math.copysign(1.0, self.flow)
            events = [*events, lambda now, y, start=t: y[2] * way + (1e-14 if now == start else 0.0)]
        for event in events:
            event.terminal = True
            event.direction = 0.0
        for i, event in enumerate(events):
            # Held bodies start where their torque grows beyond the hold; all other events are falls through zero.
            event.direction = (
                1.0 if i == 0 and rate(t, self.x)[0] == 0.0 and self.x[1] == 0.0 and event(t, self.x) < 0 else -1.0
            )
        result = solve_ivp(rate, (t, end), self.x, events=events, max_step=0.005, **self.tolerance)
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
        change_at = self.q.get("parameter_change", {}).get("time_s", math.inf)
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
                self.changed = now >= change_at
                until = min(float(times[k + 1]), float(act[j]) if j < len(act) else math.inf)
                if not self.changed:
                    until = min(until, change_at)
                run = self.run_one if self.load_j <= 0.0 else (self.run_spring if self.stiffness else self.run_two)
                run(until, now)
                now = until
        return np.array(seen)
