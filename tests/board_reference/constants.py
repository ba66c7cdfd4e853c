"""One record with everything that the reference's equations need: constants of the plant, then the regime."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_model.plants import Plant

MOTOR = ("R", "L", "Kt", "Ke", "J", "B", "coulomb", "supply")
# Field: effect and key of its table; value where the effect is absent.
TAKEN: dict[str, tuple[str, str, float]] = {
    "drift": ("supply_drift", "drift_per_s", 0.0),
    "reverse_gain": ("direction_dependent_gain", "ratio", 1.0),
    "source": ("supply_sag", "source_ohm", 0.0),
    "alpha": ("armature_heating", "alpha_per_K", 0.0),
    "thermal": ("armature_heating", "thermal_K_per_W", 0.0),
    "thermal_tau": ("armature_heating", "time_constant_s", 1.0),
    "limit": ("current_limit", "limit_A", math.inf),
    "drop": ("bridge_voltage_drop", "drop_V", 0.0),
    "diode": ("fast_decay", "diode_V", 0.0),
    "drag": ("quadratic_drag", "drag_Nms2", 0.0),
    "cog": ("cogging_torque", "torque_Nm", 0.0),
    "cog_order": ("cogging_torque", "order", 1.0),
    "cog_phase": ("cogging_torque", "phase_rad", 0.0),
    "load": ("constant_load", "torque_Nm", 0.0),
    "weight": ("gravity_load", "torque_Nm", 0.0),
    "weight_phase": ("gravity_load", "phase_rad", 0.0),
    "forward": ("asymmetric_coulomb_friction", "forward_Nm", 0.0),
    "reverse": ("asymmetric_coulomb_friction", "reverse_Nm", 0.0),
    "stiction": ("static_friction", "extra_Nm", 0.0),
    "stribeck": ("stribeck_friction", "extra_Nm", 0.0),
    "stribeck_speed": ("stribeck_friction", "stribeck_speed_rad_s", 1.0),
    "tooth": ("load_dependent_friction", "ratio", 0.0),
    "turn": ("position_dependent_friction", "ratio", 0.0),
    "turn_order": ("position_dependent_friction", "order", 1.0),
    "turn_phase": ("position_dependent_friction", "phase_rad", 0.0),
    "grease": ("friction_warm_up", "ratio", 0.0),
    "grease_tau": ("friction_warm_up", "time_constant_s", 1.0),
    "bristle": ("presliding_friction", "breakaway_rad", 0.0),
    "stop": ("hard_stop", "angle_rad", math.inf),
    "stiffness": ("shaft_compliance", "stiffness_Nm_per_rad", 0.0),
    "damping": ("shaft_compliance", "damping_Nms", 0.0),
    "viscous": ("viscous_friction", "drag_Nms", 0.0),
    "one_way": ("viscous_friction_by_direction", "drag_Nms", 0.0),
    "thin": ("sublinear_viscous_friction", "torque_Nm", 0.0),
    "knee": ("sublinear_viscous_friction", "knee_rad_s", 1.0),
    "ripple": ("clock_ripple", "ratio", 0.0),
    "ripple_hz": ("clock_ripple", "frequency_Hz", 1.0),
    "ripple_phase": ("clock_ripple", "phase_rad", 0.0),
    "magnet": ("gain_warm_up", "ratio", 0.0),
    "magnet_tau": ("gain_warm_up", "time_constant_s", 1.0),
}
# The two curves over the angle: where they begin, after which angle they repeat, and the torques of their points.
CURVES = ("load_over_position", "friction_over_position")
POINTS = 12
# Set as the run goes on: the command, what has changed, and who moves which way, is held, touches or lets flow.
REGIME = ("duty", "standby", "inertia", "friction", "gain", "side", "held", "resting", "contact", "pressed", "flow")
# resting: on the end of travel (the load, where there are two bodies); pressed: the closed face of a gap with a spring.
# limited: current at its limit, its sign; sag: the supply's share of the resistance, ohm; half: half the play;
# load_J: inertia beyond gap or spring.
# uphill: the direction that rubs more; ripples: what swings by the clock, 1 torque, 2 gain; warms: what the magnets
# follow, in the order of WARMERS; period: of the PWM, s.
OTHER = ("half", "load_J", "fast", "limited", "sag", "uphill", "ripples", "warms", "period")
WARMERS = ("running", "time", "heat")
RECORD = np.dtype(
    [(name, np.float64) for name in (*MOTOR, *TAKEN, *OTHER, *REGIME)]
    + [(name, np.float64, (2 + POINTS,)) for name in CURVES]
)

# State x: angle, speed, current, load's angle and speed, bristle, warmth of winding (K), grease and magnets (0..1).
STATES = 9
# Regimes of the current: open through the diodes or driven (its sign), none, or pulses that cease in every period.
PULSES = 2.0


def record(plant: Plant) -> Any:
    """The record of a plant at rest, an array of one."""
    c = np.zeros(1, RECORD)
    q = plant.effects
    values = (plant.R_ohm, plant.L_H, plant.Kt_Nm_per_A, plant.Ke_Vs_per_rad, plant.J_kgm2, plant.B_Nms)
    for name, value in zip(MOTOR, (*values, plant.coulomb_Nm, plant.supply_V), strict=True):
        c[name] = value
    for name, (effect, key, absent) in TAKEN.items():
        c[name] = q.get(effect, {}).get(key, absent)
    c["L"] = max(plant.L_H, q.get("armature_inductance", {}).get("inductance_H", 0.0))
    gap, spring = q.get("backlash", {}), q.get("shaft_compliance", {})
    c["half"] = 0.5 * gap.get("gap_rad", 0.0)
    c["load_J"] = max(gap.get("load_inertia_kgm2", 0.0), spring.get("load_inertia_kgm2", 0.0))
    c["fast"] = float(opens(plant))
    c["period"] = 1.0 / q.get("coast_pwm", {}).get("pwm_Hz", 20e3)
    c["uphill"] = -1.0 if q.get("viscous_friction_by_direction", {}).get("direction") == "reverse" else 1.0
    if "clock_ripple" in q:
        c["ripples"] = 1.0 if q["clock_ripple"]["of"] == "torque" else 2.0
    if "gain_warm_up" in q:
        c["warms"] = WARMERS.index(q["gain_warm_up"]["follows"])
    for name in CURVES:
        c[name][0, :2] = 0.0, 1.0
        if name in q:
            heights = [q[name][f"torque_{i}_Nm"] for i in range(1, POINTS)]
            c[name][0] = [q[name]["from_rad"], q[name]["span_rad"], *heights, -sum(heights)]
    for name in ("inertia", "friction", "gain", "standby"):
        c[name] = 1.0
    return c


def opens(plant: Plant) -> bool:
    """Whether the bridge is open between pulses."""
    return "fast_decay" in plant.effects or "coast_pwm" in plant.effects


def effective(plant: Plant, duty: float) -> float:
    """The duty in percent that the bridge makes of a commanded one, in the order of the catalogue's stages."""
    q, size, sign = plant.effects, abs(duty), math.copysign(1.0, duty)
    if "pwm_resolution" in q:
        levels = q["pwm_resolution"]["levels"]
        size = round(size / 100.0 * levels + 1e-9) * 100.0 / levels  # from halfway up
    if "duty_steps" in q:
        step, rounding = q["duty_steps"]["step_pct"], q["duty_steps"]["rounding"]
        places = {"cut": math.floor(size / step + 1e-9), "up": math.ceil(size / step - 1e-9)}
        stair = step * places.get(rounding, math.floor(size / step + 0.5 + 1e-9))
        size = min(max(size + q["duty_steps"]["share"] * (stair - size), 0.0), 100.0)
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
