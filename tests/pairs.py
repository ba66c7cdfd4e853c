"""Motors drawn at random with any effects of the library, run on the board's motor and on the fit's, to be compared.

The board's integrates amperes and newton metres, adaptively; the fit's takes exact steps in percent and degrees. What
connects them is ``Plant.reduced``: the one place where a plant's constants become percent, degrees and seconds.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiohost.motor.effect import effects as library
from fiohost.motor.hooks import measure
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, Start, run, seen_angle, start_state
from firmware_model.layout import LOAD_THETA, THETA, C
from firmware_model.motor import Motor, constants, measured
from firmware_model.plants import Plant, make_plant
from firmware_model.report import PERIOD

TICK_S = 0.005
BRAKE, DRIVE, STANDBY = 2, 1, 0
Values = dict[str, Any]


def between(rng: random.Random, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def draw_motor(rng: random.Random) -> Values:
    """A geared motor without viscous damping, whose winding may be without inductance."""
    gain, tau, stall_share = between(rng, 5.0, 20.0), between(rng, 0.03, 0.25), between(rng, 0.008, 0.06)
    supply, ohms = between(rng, 5.0, 24.0), between(rng, 1.0, 9.0)
    back_emf = supply / (100.0 * math.radians(gain))
    kt = rng.uniform(0.65, 1.0) * back_emf
    return {
        "supply_V": supply, "R_ohm": ohms, "Kt_Nm_per_A": kt, "Ke_Vs_per_rad": back_emf,
        "J_kgm2": tau * kt * back_emf / ohms, "coulomb_Nm": stall_share * kt * supply / ohms,
    }  # fmt: skip


def stall(m: Values) -> float:
    return float(m["Kt_Nm_per_A"] * m["supply_V"] / m["R_ohm"])


def viscous(m: Values) -> float:
    """The damping of the back-emf in N m per rad/s."""
    return float(m["Kt_Nm_per_A"] * m["Ke_Vs_per_rad"] / m["R_ohm"])


def _curve(rng: random.Random, size_Nm: float) -> Values:
    """A curve of half a turn to two, of this size."""
    points = {f"torque_{i}_Nm": rng.uniform(-size_Nm, size_Nm) for i in range(1, 12)}
    return {"from_rad": _turn(rng), "span_rad": between(rng, math.pi, 4.0 * math.pi), **points}


def _turn(rng: random.Random) -> float:
    return rng.uniform(0.0, 2.0 * math.pi)


def _sign(rng: random.Random) -> float:
    return rng.choice((-1.0, 1.0))


def _backlash(r: random.Random, m: Values) -> Values:
    side = r.choice(("encoder_after_gap", "encoder_before_gap"))
    share = r.choice((0.0, r.uniform(0.1, 0.6)))
    return {"gap_deg": between(r, 0.5, 10.0), "side": side, "load_inertia_kgm2": share * m["J_kgm2"]}


def _spring(r: random.Random, m: Values) -> Values:
    share, pulse = r.uniform(0.1, 0.6), 2.0 * math.pi * between(r, 4.0, 40.0)
    both = m["J_kgm2"] * share * (1.0 - share)
    return {
        "stiffness_Nm_per_rad": both * pulse**2,
        "damping_Nms": 2.0 * between(r, 0.02, 0.5) * pulse * both,
        "load_inertia_kgm2": share * m["J_kgm2"],
        "side": r.choice(("encoder_before_spring", "encoder_after_spring")),
    }


DRAWS: Mapping[str, Callable[[random.Random, Values], Values]] = {
    "armature_heating": lambda r, m: {
        "alpha_per_K": 0.0039,
        "thermal_K_per_W": between(r, 0.3, 3.0) / (0.0039 * m["supply_V"] ** 2 / m["R_ohm"]),
        "time_constant_s": between(r, 2.0, 30.0),
    },
    "armature_inductance": lambda r, m: {"inductance_H": between(r, 0.0005, 0.012) * m["R_ohm"]},
    "asymmetric_coulomb_friction": lambda r, m: {
        "forward_Nm": r.uniform(0.1, 1.0) * m["coulomb_Nm"], "reverse_Nm": r.uniform(0.1, 1.0) * m["coulomb_Nm"],
    },
    "asymmetric_deadband": lambda r, m: {"u_plus_pct": between(r, 0.5, 8.0), "u_minus_pct": -between(r, 0.5, 8.0)},
    "backlash": _backlash,
    "bridge_voltage_drop": lambda r, m: {"drop_V": between(r, 0.005, 0.06) * m["supply_V"]},
    "cogging_torque": lambda r, m: {
        "order": float(r.choice((2, 3, 4, 6, 8, 12, 15, 20))),
        "torque_Nm": between(r, 0.005, 0.05) * stall(m), "phase_rad": _turn(r),
    },
    "clock_ripple": lambda r, m: {
        "ratio": between(r, 0.003, 0.05), "frequency_Hz": between(r, 0.3, 20.0), "phase_rad": _turn(r),
        "of": r.choice(("torque", "gain")),
    },
    "coast_pwm": lambda r, m: {"pwm_Hz": between(r, 200.0, 1500.0)},
    "constant_load": lambda r, m: {"torque_Nm": _sign(r) * between(r, 0.003, 0.06) * stall(m)},
    "current_limit": lambda r, m: {"limit_A": r.uniform(0.25, 0.9) * m["supply_V"] / m["R_ohm"]},
    "direction_dependent_gain": lambda r, m: {"ratio": 1.0 + _sign(r) * between(r, 0.01, 0.2)},
    "duty_curve": lambda r, m: {"exponent": 1.0 + _sign(r) * between(r, 0.02, 0.3)},
    "duty_steps": lambda r, m: {
        "step_pct": r.choice((5.0, 12.5, 20.0, 33.0)), "share": _sign(r) * between(r, 0.02, 0.5),
        "rounding": r.choice(("cut", "nearest", "up")),
    },
    "encoder_eccentricity": lambda r, m: {
        "level_deg": between(r, 0.3, 2.0), "order": float(r.choice((1, 1, 2, 4))), "phase_rad": _turn(r),
    },
    "fast_decay": lambda r, m: {},
    "friction_over_position": lambda r, m: _curve(r, 0.5 * m["coulomb_Nm"]),
    "friction_warm_up": lambda r, m: {"ratio": r.uniform(0.1, 0.7), "time_constant_s": between(r, 2.0, 30.0)},
    "gain_warm_up": lambda r, m: {
        "ratio": _sign(r) * between(r, 0.005, 0.2), "time_constant_s": between(r, 2.0, 30.0),
        "follows": r.choice(("running", "time", "heat")),
    },
    "gravity_load": lambda r, m: {"torque_Nm": between(r, 0.004, 0.08) * stall(m), "phase_rad": _turn(r)},
    "hard_stop": lambda r, m: {"angle_deg": _sign(r) * between(r, 5.0, 300.0)},
    "input_deadband": lambda r, m: {"level_pct": between(r, 0.5, 10.0)},
    "load_dependent_friction": lambda r, m: {"ratio": between(r, 0.03, 0.3)},
    "load_over_position": lambda r, m: _curve(r, between(r, 0.004, 0.05) * stall(m)),
    "missed_counts": lambda r, m: {"ratio": between(r, 0.002, 0.05)},
    "parameter_change": lambda r, m: {
        "time_s": r.choice((r.uniform(0.2, 0.9), r.uniform(2.0, 12.0))),
        "which": r.choice(("inertia", "friction", "gain")), "ratio": between(r, 0.5, 2.0),
    },
    "position_dependent_friction": lambda r, m: {
        "ratio": r.uniform(0.1, 0.6), "order": float(r.choice((1, 1, 2, 4))), "phase_rad": _turn(r),
    },
    "presliding_friction": lambda r, m: {"breakaway_deg": between(r, 0.2, 4.0)},
    "pwm_dead_time": lambda r, m: {"time_s": between(r, 1e-7, 3e-6)},
    "pwm_resolution": lambda r, m: {
        "levels": float(r.choice((16, 50, 100, 255))), "rounding": r.choice(("cut", "nearest")),
    },
    "quadratic_drag": lambda r, m: {"drag_Nms2": between(r, 0.01, 0.1) * stall(m) / math.radians(1000.0) ** 2},
    "shaft_angle_error": lambda r, m: {
        **{f"level_{n}_deg": between(r, 0.1, 1.0) for n in (1, 2, 3)},
        **{f"phase_{n}_rad": _turn(r) for n in (1, 2, 3)},
    },
    "shaft_compliance": _spring,
    "static_friction": lambda r, m: {"extra_Nm": between(r, 0.005, 0.05) * stall(m)},
    "stribeck_friction": lambda r, m: {
        "extra_Nm": between(r, 0.005, 0.04) * stall(m), "stribeck_speed_rad_s": between(r, 0.3, 4.0),
    },
    "sublinear_viscous_friction": lambda r, m: {
        "torque_Nm": between(r, 0.005, 0.04) * stall(m), "knee_rad_s": between(r, 0.5, 10.0),
    },
    "supply_drift": lambda r, m: {"drift_per_s": _sign(r) * between(r, 2e-4, 2e-3)},
    "supply_sag": lambda r, m: {
        "source_ohm": between(r, 0.03, 0.4) * m["R_ohm"], "smoothing": r.choice(("capacitor", "none")),
    },
    "transport_delay": lambda r, m: {"delay_s": between(r, 0.0005, 0.03)},
    "viscous_friction": lambda r, m: {"drag_Nms": between(r, 0.02, 0.5) * viscous(m)},
    "viscous_friction_by_direction": lambda r, m: {
        "drag_Nms": between(r, 0.02, 0.5) * viscous(m), "direction": r.choice(("forward", "reverse")),
    },
    "voltage_saturation": lambda r, m: {"limit_pct": r.uniform(30.0, 90.0)},
}  # fmt: skip
NAMES = tuple(DRAWS)
# One bridge or winding said in two ways.
EITHER = ({"coast_pwm", "fast_decay"}, {"coast_pwm", "armature_inductance"})
PAIRS = tuple(pair for pair in itertools.combinations(NAMES, 2) if set(pair) not in EITHER)


def draw_plant(rng: random.Random, names: tuple[str, ...], *, friction: bool = True) -> Plant:
    """A plant with these effects, each of random size."""
    motor = draw_motor(rng)
    if "fast_decay" in names:
        motor["L_H"] = between(rng, 0.0005, 0.006) * motor["R_ohm"]
    elif "coast_pwm" in names:
        motor["L_H"] = between(rng, 0.00003, 0.00005) * motor["R_ohm"]
    if not friction:
        motor["coulomb_Nm"] = 0.0
    return make_plant({**motor, "effects": {name: DRAWS[name](rng, motor) for name in names}}, "drawn")


def draw_commands(rng: random.Random, span_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Modes and duties (n) in percent: held levels, ramps, sines, rests, brakes and run-downs one after another, in
    steps of the board's timer: a pulse of a millionth of a period there is none.
    """
    n, modes, duties = round(span_s / TICK_S), [], []
    while len(duties) < n:
        ticks = rng.randint(10, 120)
        kind = rng.choice(("level", "level", "level", "ramp", "sine", "brake", "standby"))
        size = _sign(rng) * between(rng, 2.0, 100.0)
        t = np.arange(ticks) / ticks
        mode = {"brake": BRAKE, "standby": STANDBY}.get(kind, DRIVE)
        shape = {"level": np.ones(ticks), "ramp": 1.0 - 2.0 * t, "sine": np.sin(2 * np.pi * rng.uniform(0.5, 4.0) * t)}
        duties += list(size * shape[kind]) if mode == DRIVE else [0.0] * ticks
        modes += [mode] * ticks
    per_pct = PERIOD / 100.0
    return np.array(modes[:n], np.int64), np.trunc(np.array(duties[:n]) * per_pct) / per_pct


def as_model(plant: Plant) -> Model:
    """The fit's model of a plant, in percent, degrees and seconds."""
    reduced = plant.reduced()
    values: Values = {}
    for name, inner in reduced.items():
        values.update({f"{name}.{key}": value for key, value in inner.items()})
    if "stribeck_friction.extra_pct" in values:
        values["stribeck_friction.shape"] = "gaussian"
    if "fast_decay" in reduced or ("coast_pwm" in reduced and "armature_inductance" not in plant.effects):
        values.pop("armature_inductance.time_constant_s", None)
        reduced.pop("armature_inductance", None)
    names = tuple(name for name in library() if name in reduced and name != "linear")
    pwm_hz = float(plant.effects.get("coast_pwm", {}).get("pwm_Hz", plant.pwm_hz))
    return Model(names, values, pwm_hz=pwm_hz)


# In the first second, and over a whole run: a count is half a degree.
FIRST_SECOND_DEG, WHOLE_RUN_DEG, OF_THE_WAY = 0.1, 0.5, 2e-4
RULE = (
    "Board and fit agree on a run where the shown angles never differ by more than 0.1 deg in the first second, and by "
    "more than 0.5 deg plus 0.02 % of the way turned in all of it; where a gain that is off by a millionth moves the "
    "run by more than that millionth of the way and a hundredth of a degree, the motion is chaotic and only its first "
    "second counts."
)
MILLIONTH = 1e-6


@dataclass(frozen=True)
class Both:
    """Shown angles (n) in degrees of one motor on the board and in the fit at the ticks, and those of the fit with a
    gain that is off by a millionth.
    """

    board_deg: np.ndarray
    host_deg: np.ndarray
    beside_deg: np.ndarray

    @property
    def first_deg(self) -> float:
        """Largest difference in the first second."""
        return self._apart(self.board_deg, self.host_deg, round(1.0 / TICK_S))

    @property
    def whole_deg(self) -> float:
        """Largest difference in the whole run."""
        return self._apart(self.board_deg, self.host_deg, None)

    @property
    def turned_deg(self) -> float:
        return float(np.sum(np.abs(np.diff(self.board_deg))))

    @property
    def is_chaotic(self) -> bool:
        return self._apart(self.host_deg, self.beside_deg, None) > 0.01 + 2.0 * MILLIONTH * self.turned_deg

    @property
    def agrees(self) -> bool:
        """Whether they do by the rule."""
        if not self.first_deg <= FIRST_SECOND_DEG:
            return False
        return self.is_chaotic or self.whole_deg <= WHOLE_RUN_DEG + OF_THE_WAY * self.turned_deg

    @staticmethod
    def _apart(a: np.ndarray, b: np.ndarray, n: int | None) -> float:
        return float(np.max(np.abs(a[:n] - b[:n])))


def on_board(plant: Plant, modes: np.ndarray, duties: np.ndarray, pwm: str | None = None) -> np.ndarray:
    """Angles (n) in degrees that the encoder's disc shows before each command."""
    motor = Motor(plant, pwm=pwm)
    _, states = motor.run_many(modes, duties, TICK_S)
    p, on = constants(plant)
    body = states[:, LOAD_THETA if p[C.AFTER] else THETA]
    lost = float(plant.effects.get("missed_counts", {}).get("ratio", 0.0))
    return np.degrees([measured(float(angle), p, on) * (1.0 - lost) for angle in body])


def on_host(model: Model, start_deg: float, modes: np.ndarray, duties: np.ndarray) -> np.ndarray:
    """The same from the fit's kernel, from an angle of the motor; before the first command nothing drives."""
    times = np.arange(len(duties)) * TICK_S
    before = np.concatenate(([STANDBY], modes)).astype(np.int64)
    excitation = Excitation(times, times, np.concatenate(([0.0], duties)), before)
    p, on = model.vector(), model.switches()
    states = run(excitation, p, on, model.substep_s(), start_state(Start(start_deg, 0.0), p, on))
    return np.array([measure(float(angle), (), p, on) for angle in states[:, seen_angle(p, on)]])


def compare(plant: Plant, modes: np.ndarray, duties: np.ndarray, pwm: str | None = None) -> Both:
    """One motor on both, from the middle of its count and of its play; ``pwm`` takes the place of the plant's."""
    start, model = 180.0 / plant.counts_per_rev, as_model(plant)
    gain = "linear.gain_deg_s_per_pct"
    beside = model.with_values({gain: model.number(gain) * (1.0 + MILLIONTH)})
    hosts = (on_host(m, start, modes, duties) for m in (model, beside))
    return Both(on_board(plant, modes, duties, pwm), *hosts)


def draw_run(names: tuple[str, ...], seed: int, span_s: float) -> Both:
    """A motor with these effects and commands for it, drawn by a seed, on both sides.

    What limits or breaks off the current within a PWM period is compared with the board whose edges are resolved, where
    the winding has a lag: there the mean of a period is not all. Slow pulses shake the shaft; their means are compared.
    """
    rng = random.Random(f"{names} {seed}")
    plant = draw_plant(rng, names)
    modes, duties = draw_commands(rng, span_s)
    within = {"current_limit", "bridge_voltage_drop"} & plant.effects.keys()
    ripples = plant.inductance_H > 0.0 and bool(within) and "coast_pwm" not in names
    return compare(plant, modes, duties, "edge_resolved" if ripples else None)
