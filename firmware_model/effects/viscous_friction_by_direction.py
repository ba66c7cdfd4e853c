"""Bearings or gears that are harder to turn one way round."""

import math

from firmware_model.effect import Effect, Parameter


def motor_torque(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    way = 1.0 - 2.0 * p[k + 1]
    return value - p[k] * way * max(way * omega, 0.0)


EFFECT = Effect(
    name="viscous_friction_by_direction",
    summary="more viscous friction in one direction",
    equation="T = -drag omega where the shaft turns in the direction",
    parameters=(
        Parameter("drag_Nms", lower=0.0),
        Parameter("direction", default=0.0, choices=("forward", "reverse")),
    ),
    source="Armstrong-Helouvry, Control of Machines with Friction, 1991",
    reduced=lambda plant, q: {
        "pct_at_1000_deg_s": plant.percent_of_torque(q["drag_Nms"] * math.radians(1000.0)),
        "direction": q["direction"],
    },
    motor_torque=motor_torque,
)
