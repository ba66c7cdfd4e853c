"""Every effect of the board at a drawn size that shows, for comparisons; SI, as in a plant file."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from firmware_model.plants import Plant, make_plant

Draw = Callable[[np.random.Generator], Any]


def between(low: float, high: float) -> Callable[[np.random.Generator], float]:
    """Log-uniform."""
    return lambda rng: float(math.exp(rng.uniform(math.log(low), math.log(high))))


def phase(rng: np.random.Generator) -> float:
    return float(rng.uniform(-180.0, 180.0))


def either(low: float, high: float) -> Callable[[np.random.Generator], float]:
    return lambda rng: float(rng.choice((-1.0, 1.0))) * between(low, high)(rng)


def order(rng: np.random.Generator) -> int:
    return int(rng.integers(1, 13))


def points(size_Nm: float) -> dict[str, Draw]:
    """The torques of a curve over the angle."""
    return {f"torque_{i}_Nm": lambda rng: float(rng.uniform(-size_Nm, size_Nm)) for i in range(1, 12)}


# A number stands for itself, a function draws.
SIZES: dict[str, dict[str, Any]] = {
    "armature_heating": {"thermal_K_per_W": between(5.0, 30.0), "time_constant_s": between(3.0, 40.0)},
    "armature_inductance": {"inductance_H": between(0.002, 0.03)},
    "asymmetric_coulomb_friction": {"forward_Nm": between(0.003, 0.03), "reverse_Nm": between(0.003, 0.03)},
    "asymmetric_deadband": {"u_plus_pct": between(1.0, 12.0), "u_minus_pct": lambda rng: -between(1.0, 12.0)(rng)},
    "backlash": {
        "gap_deg": between(0.5, 6.0),
        "side": lambda rng: str(rng.choice(("encoder_after_gap", "encoder_before_gap"))),
        "load_inertia_kgm2": lambda rng: float(rng.choice((0.0, rng.uniform(0.2, 0.7) * MOTOR["J_kgm2"]))),
    },
    "bridge_voltage_drop": {"drop_V": between(0.1, 1.0)},
    "cogging_torque": {"order": order, "torque_Nm": between(0.003, 0.03), "phase_deg": phase},
    "constant_load": {"torque_Nm": either(0.005, 0.06)},
    "current_limit": {"limit_A": between(0.15, 0.9)},
    "direction_dependent_gain": {"ratio": between(0.7, 1.4)},
    "duty_curve": {"exponent": between(0.7, 1.5)},
    "encoder_eccentricity": {"level_deg": between(0.2, 2.0), "order": order, "phase_deg": phase},
    "clock_ripple": {
        "ratio": between(0.005, 0.1),
        "frequency_Hz": between(0.3, 30.0),
        "phase_deg": phase,
        "of": lambda rng: str(rng.choice(("torque", "gain"))),
    },
    "coast_pwm": {"pwm_Hz": between(300.0, 2000.0)},
    "duty_steps": {
        "step_pct": between(3.0, 30.0),
        "share": either(0.05, 0.6),
        "rounding": lambda rng: str(rng.choice(("cut", "nearest", "up"))),
    },
    "fast_decay": {"diode_V": lambda rng: float(rng.uniform(0.0, 1.0))},
    "friction_warm_up": {"ratio": between(0.1, 0.6), "time_constant_s": between(1.0, 20.0)},
    "friction_over_position": {"from_deg": phase, "span_deg": between(90.0, 1440.0), **points(0.01)},
    "gain_warm_up": {
        "ratio": either(0.02, 0.4),
        "time_constant_s": between(0.5, 20.0),
        "follows": lambda rng: str(rng.choice(("running", "time", "heat"))),
    },
    "gravity_load": {"torque_Nm": between(0.005, 0.08), "phase_deg": phase},
    "hard_stop": {"angle_deg": either(15.0, 90.0)},
    "input_deadband": {"level_pct": between(1.0, 12.0)},
    "load_dependent_friction": {"ratio": between(0.03, 0.3)},
    "load_over_position": {"from_deg": phase, "span_deg": between(90.0, 1440.0), **points(0.03)},
    "missed_counts": {"ratio": between(0.002, 0.1)},
    "parameter_change": {
        "time_s": lambda rng: float(rng.uniform(0.2, 10.0)),
        "which": lambda rng: str(rng.choice(("inertia", "friction", "gain"))),
        "ratio": between(0.5, 2.0),
    },
    "position_dependent_friction": {"ratio": between(0.1, 0.8), "order": order, "phase_deg": phase},
    "presliding_friction": {"breakaway_deg": between(0.2, 2.0)},
    "pwm_dead_time": {"time_s": between(3e-7, 4e-6)},
    "pwm_resolution": {"levels": lambda rng: int(rng.integers(20, 256))},
    "quadratic_drag": {"drag_Nms2": between(3e-5, 5e-4)},
    "shaft_angle_error": {
        key: draw for n in (1, 2, 3) for key, draw in ((f"level_{n}_deg", between(0.1, 1.0)), (f"phase_{n}_deg", phase))
    },
    "shaft_compliance": {
        "stiffness_Nm_per_rad": between(2.0, 30.0),
        "damping_Nms": between(0.001, 0.01),
        "load_inertia_kgm2": lambda rng: float(rng.uniform(0.2, 0.7)) * MOTOR["J_kgm2"],
        "side": lambda rng: str(rng.choice(("encoder_after_spring", "encoder_before_spring"))),
    },
    "slot_errors": {
        "slot_counts": between(0.05, 0.24),
        "phase_counts": between(0.05, 0.24),
        "seed": lambda rng: int(rng.integers(1000)),
    },
    "static_friction": {"extra_Nm": between(0.003, 0.03)},
    "stribeck_friction": {"extra_Nm": between(0.003, 0.03), "stribeck_speed_rad_s": between(0.3, 3.0)},
    "supply_drift": {"drift_per_s": either(5e-4, 1e-2)},
    "sublinear_viscous_friction": {"torque_Nm": between(0.002, 0.02), "knee_rad_s": between(0.3, 10.0)},
    "supply_sag": {
        "source_ohm": between(0.2, 3.0),
        "smoothing": lambda rng: str(rng.choice(("capacitor", "none"))),
    },
    "transport_delay": {"delay_s": between(0.002, 0.05)},
    "viscous_friction": {"drag_Nms": between(3e-4, 1e-2)},
    "viscous_friction_by_direction": {
        "drag_Nms": between(3e-4, 1e-2),
        "direction": lambda rng: str(rng.choice(("forward", "reverse"))),
    },
    "voltage_saturation": {"limit_pct": lambda rng: float(rng.uniform(20.0, 70.0))},
}

# The default plant's motor.
MOTOR = {
    "supply_V": 9.0,
    "R_ohm": 5.515,
    "Kt_Nm_per_A": 0.3408,
    "Ke_Vs_per_rad": 0.4869,
    "J_kgm2": 3.07e-3,
    "coulomb_Nm": 0.02045,
}
WINDING_H = 0.015


def drawn(name: str, rng: np.random.Generator) -> dict[str, Any]:
    """The table of one effect."""
    return {key: size(rng) if callable(size) else size for key, size in SIZES[name].items()}


def plant_with(effects: dict[str, dict[str, Any]], inductance_H: float = WINDING_H) -> Plant:
    """The default motor with these effects."""
    return make_plant({**MOTOR, "L_H": inductance_H, "effects": effects}, "+".join(effects) or "no effect")


def drawn_pair(rng: np.random.Generator) -> Plant:
    """The default motor with two effects, its winding with or without inductance."""
    names = [str(name) for name in rng.choice(sorted(SIZES), 2, replace=False)]
    inductance_H = WINDING_H if {"fast_decay", "coast_pwm"} & set(names) or rng.random() < 0.5 else 0.0
    return plant_with({name: drawn(name, rng) for name in names}, inductance_H)
