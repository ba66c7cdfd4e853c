"""Drag with speed squared (fans, windage)."""

import math

from firmware_model.effect import Effect, Parameter


def motor_torque(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value - p[k] * omega * abs(omega)


EFFECT = Effect(
    name="quadratic_drag",
    summary="drag growing with speed squared",
    equation="T = -drag omega |omega|",
    parameters=(Parameter("drag_Nms2", lower=0.0),),
    source="Fan law; fluid mechanics",
    reduced=lambda plant, q: {"pct_at_1000_deg_s": plant.percent_of_torque(q["drag_Nms2"] * math.radians(1000.0) ** 2)},
    motor_torque=motor_torque,
)
