"""Viscous damping of the bearings, beside what the plant's own key gives."""

import math

from firmware_model.effect import Effect, Parameter


def motor_torque(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value - p[k] * omega


EFFECT = Effect(
    name="viscous_friction",
    summary="viscous friction apart from the back-emf",
    equation="T = -drag omega",
    parameters=(Parameter("drag_Nms", lower=0.0),),
    source="Viscous damping of bearings",
    reduced=lambda plant, q: {"pct_at_1000_deg_s": plant.percent_of_torque(q["drag_Nms"] * math.radians(1000.0))},
    motor_torque=motor_torque,
)
