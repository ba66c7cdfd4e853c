"""Random cases for the discovery benchmark: plants and effects drawn wide, simulated by the board, told to nobody.

Sizes are drawn, not chosen: how clear a case is follows from the error of the declared model over its floor.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from firmware_model.plants import Plant, make_plant

SUPPLY_V = 9.0
Values = dict[str, Any]


def spread(rng: random.Random, low: float, high: float) -> float:
    """Log-uniform."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def motor(rng: random.Random) -> Values:
    """A geared motor with dry friction and nothing else: gain 6 to 16 deg/s per %, lag 40 to 150 ms, friction 1
    to 6 %.
    """
    gain, tau, friction = spread(rng, 6.0, 16.0), spread(rng, 0.04, 0.15), spread(rng, 1.0, 6.0)
    resistance = spread(rng, 3.0, 9.0)
    back_emf = SUPPLY_V / (100.0 * math.radians(gain))
    kt = rng.uniform(0.65, 0.95) * back_emf
    return {
        "supply_V": SUPPLY_V,
        "R_ohm": resistance,
        "Kt_Nm_per_A": kt,
        "Ke_Vs_per_rad": back_emf,
        "J_kgm2": tau * kt * back_emf / resistance,
        "coulomb_Nm": friction / 100.0 * kt * SUPPLY_V / resistance,
    }


def stall_Nm(m: Mapping[str, Any]) -> float:
    return float(m["Kt_Nm_per_A"] * SUPPLY_V / m["R_ohm"])


def sign(rng: random.Random) -> float:
    return rng.choice((-1.0, 1.0))


def _compliance(rng: random.Random, m: Values) -> Values:
    share = rng.uniform(0.15, 0.5)
    pulse = 2.0 * math.pi * spread(rng, 4.0, 25.0)
    both = m["J_kgm2"] * share * (1.0 - share)
    return {
        "stiffness_Nm_per_rad": both * pulse**2,
        "damping_Nms": 2.0 * rng.uniform(0.02, 0.15) * pulse * both,
        "load_inertia_kgm2": share * m["J_kgm2"],
        "side": "encoder_before_spring",
    }


def _backlash(rng: random.Random, m: Values) -> Values:
    if rng.random() < 0.5:
        return {"gap_rad": math.radians(spread(rng, 0.7, 6.0)), "side": "encoder_after_gap"}
    gap = math.radians(spread(rng, 2.0, 12.0))
    return {"gap_rad": gap, "side": "encoder_before_gap", "load_inertia_kgm2": rng.uniform(0.2, 0.6) * m["J_kgm2"]}


def _turn(rng: random.Random) -> float:
    return rng.uniform(0.0, 2.0 * math.pi)


# SI parameters of each effect at a drawn size.
EFFECTS: dict[str, Callable[[random.Random, Values], Values]] = {
    "asymmetric_coulomb_friction": lambda r, m: _asymmetric(r, m),
    "static_friction": lambda r, m: {"extra_Nm": spread(r, 0.01, 0.05) * stall_Nm(m)},
    "stribeck_friction": lambda r, m: {
        "extra_Nm": spread(r, 0.003, 0.05) * stall_Nm(m),
        "stribeck_speed_rad_s": spread(r, 0.2, 4.0),
    },
    "presliding_friction": lambda r, m: {"breakaway_rad": math.radians(spread(r, 0.2, 3.0))},
    "load_dependent_friction": lambda r, m: {"ratio": spread(r, 0.02, 0.3)},
    "quadratic_drag": lambda r, m: {"drag_Nms2": spread(r, 0.003, 0.08) * stall_Nm(m) / math.radians(1000.0) ** 2},
    "constant_load": lambda r, m: {"torque_Nm": sign(r) * spread(r, 0.00002, 0.06) * stall_Nm(m)},
    "gravity_load": lambda r, m: {"torque_Nm": spread(r, 0.002, 0.08) * stall_Nm(m), "phase_rad": _turn(r)},
    "cogging_torque": lambda r, m: {
        "order": float(r.choice((2, 3, 4, 6, 8, 12, 15, 20))),
        "torque_Nm": spread(r, 0.001, 0.06) * stall_Nm(m),
        "phase_rad": _turn(r),
    },
    "position_dependent_friction": lambda r, m: {
        "ratio": spread(r, 0.01, 0.6),
        "order": float(r.choice((1, 1, 2, 4))),
        "phase_rad": _turn(r),
    },
    "backlash": _backlash,
    "shaft_compliance": _compliance,
    "input_deadband": lambda r, m: {"level_pct": spread(r, 0.01, 12.0)},
    "asymmetric_deadband": lambda r, m: _edges(r),
    "bridge_voltage_drop": lambda r, m: {"drop_V": spread(r, 0.0003, 0.06) * SUPPLY_V},
    "pwm_dead_time": lambda r, m: {"time_s": spread(r, 0.01e-6, 4e-6)},
    "fast_decay": lambda r, m: {},
    "duty_curve": lambda r, m: {"exponent": 1.0 + sign(r) * spread(r, 0.0005, 0.3)},
    "pwm_resolution": lambda r, m: {"levels": float(r.choice((10, 16, 20, 32, 50, 64, 100)))},
    "voltage_saturation": lambda r, m: {"limit_pct": r.uniform(35.0, 85.0)},
    "current_limit": lambda r, m: {"limit_A": r.uniform(0.3, 0.9) * SUPPLY_V / m["R_ohm"]},
    "supply_sag": lambda r, m: {"source_ohm": spread(r, 0.02, 0.4) * m["R_ohm"]},
    "supply_drift": lambda r, m: {"drift_per_s": sign(r) * spread(r, 3e-5, 1.5e-3)},
    "armature_heating": lambda r, m: {
        "thermal_K_per_W": spread(r, 5.0, 80.0),
        "time_constant_s": spread(r, 5.0, 60.0),
    },
    "friction_warm_up": lambda r, m: {"ratio": r.uniform(0.15, 0.6), "time_constant_s": spread(r, 4.0, 60.0)},
    "armature_inductance": lambda r, m: {"inductance_H": spread(r, 0.0007, 0.012) * m["R_ohm"]},
    "transport_delay": lambda r, m: {"delay_s": spread(r, 0.0007, 0.04)},
    "direction_dependent_gain": lambda r, m: {"ratio": 1.0 + sign(r) * spread(r, 0.0003, 0.2)},
    "encoder_eccentricity": lambda r, m: {
        "level_rad": math.radians(spread(r, 0.2, 2.0)),
        "order": float(r.choice((1, 1, 2, 4, 15))),
        "phase_rad": _turn(r),
    },
    "parameter_change": lambda r, m: {
        "time_s": r.uniform(30.0, 150.0),
        "which": r.choice(("inertia", "friction", "gain")),
        "ratio": r.choice((1.0 + spread(r, 0.05, 0.6), 1.0 / (1.0 + spread(r, 0.05, 0.6)))),
    },
    "hard_stop": lambda r, m: {"angle_rad": sign(r) * math.radians(r.uniform(200.0, 1500.0))},
    "clock_ripple": lambda r, m: {
        "ratio": spread(r, 0.001, 0.03),
        "frequency_Hz": spread(r, 0.3, 10.0),
        "phase_rad": _turn(r),
        "of": r.choice(("torque", "gain")),
    },
    "coast_pwm": lambda r, m: {"pwm_Hz": spread(r, 200.0, 1000.0)},
    "duty_steps": lambda r, m: {
        "step_pct": r.choice((5.0, 10.0, 20.0, 25.0)),
        "share": sign(r) * spread(r, 0.01, 0.4),
        "rounding": r.choice(("cut", "nearest")),
    },
    "friction_over_position": lambda r, m: _curve(r, spread(r, 0.05, 0.7) * m["coulomb_Nm"]),
    "gain_warm_up": lambda r, m: {
        "ratio": sign(r) * spread(r, 0.003, 0.15),
        "time_constant_s": spread(r, 4.0, 60.0),
        "follows": r.choice(("running", "time", "heat")),
    },
    "load_over_position": lambda r, m: _curve(r, spread(r, 0.002, 0.05) * stall_Nm(m)),
    "shaft_angle_error": lambda r, m: {
        **{f"level_{n}_rad": math.radians(spread(r, 0.1, 1.5) / n) for n in (1, 2, 3)},
        **{f"phase_{n}_rad": _turn(r) for n in (1, 2, 3)},
    },
    "sublinear_viscous_friction": lambda r, m: {
        "torque_Nm": spread(r, 0.001, 0.03) * stall_Nm(m),
        "knee_rad_s": spread(r, 0.5, 5.0),
    },
    "viscous_friction_by_direction": lambda r, m: {
        "drag_Nms": spread(r, 0.005, 0.3) * m["Kt_Nm_per_A"] * m["Ke_Vs_per_rad"] / m["R_ohm"],
        "direction": r.choice(("forward", "reverse")),
    },
}
# Those of which rates can be drawn beside the others; the fixed cases of the smoke run stay as they were drawn.
YOUNG = frozenset({
    "clock_ripple", "coast_pwm", "duty_steps", "friction_over_position", "gain_warm_up", "load_over_position",
    "shaft_angle_error", "sublinear_viscous_friction", "viscous_friction_by_direction",
})  # fmt: skip


def _curve(rng: random.Random, size_Nm: float) -> Values:
    """A curve of this size that repeats once a turn: a few of its lowest orders."""
    orders = [(rng.uniform(0.3, 1.0) / n, n, _turn(rng)) for n in (1, 2, 3)]
    heights = [sum(a * math.sin(2.0 * math.pi * n * k / 12 + phase) for a, n, phase in orders) for k in range(11)]
    largest = max(abs(h) for h in heights)
    return {f"torque_{k + 1}_Nm": size_Nm * h / largest for k, h in enumerate(heights)}


def _asymmetric(rng: random.Random, m: Values) -> Values:
    mean = m["coulomb_Nm"]
    part = sign(rng) * spread(rng, 0.003, 0.5)
    return {"forward_Nm": mean * (1.0 + part), "reverse_Nm": mean * (1.0 - part)}


def _edges(rng: random.Random) -> Values:
    wide = spread(rng, 0.02, 10.0)
    narrow = wide * rng.uniform(0.2, 0.7)
    plus, minus = (wide, narrow) if rng.random() < 0.5 else (narrow, wide)
    return {"u_plus_pct": plus, "u_minus_pct": -minus}


@dataclass(frozen=True)
class Case:
    """One plant; ``truth`` are its undeclared effects, ``values`` what it was made of."""

    seed: int
    truth: tuple[str, ...]
    plant: Plant
    reduced: dict[str, dict[str, Any]]
    values: Values


def make_case(seed: int, names: tuple[str, ...]) -> Case:
    """The plant of a seed with the named effects at drawn sizes. Raises FirmwareModelError for sizes that clash."""
    rng = random.Random(f"case {seed}")
    m = motor(rng)
    effects = {name: EFFECTS[name](rng, m) for name in names}
    if "asymmetric_coulomb_friction" in effects:
        m["coulomb_Nm"] = 0.0
    if "fast_decay" in effects:
        m["L_H"] = spread(rng, 0.0005, 0.004) * m["R_ohm"]
    elif "coast_pwm" in effects:
        m["L_H"] = spread(rng, 0.00003, 0.0003) * m["R_ohm"]
    values = {**m, "effects": effects}
    plant = make_plant(values, "case")
    return Case(seed, names, plant, plant.reduced(), values)
