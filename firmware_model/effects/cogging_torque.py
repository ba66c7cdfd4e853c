"""Torque ripple of magnets, commutator or gear teeth."""

import math

from firmware_model.effect import Effect, Parameter


def motor_torque(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value - p[k + 1] * math.sin(p[k] * theta + p[k + 2])


EFFECT = Effect(
    name="cogging_torque",
    summary="torque ripple, order times a turn",
    equation="T = -torque sin(order theta + phase)",
    parameters=(
        Parameter("order", lower=1.0, upper=1000.0),
        Parameter("torque_Nm", lower=0.0),
        Parameter("phase_rad", default=0.0),
    ),
    source="Hanselman, Brushless Permanent Magnet Motor Design",
    reduced=lambda plant, q: {
        "order": q["order"],
        "level_pct": plant.percent_of_torque(q["torque_Nm"]),
        "phase_deg": math.degrees(q["phase_rad"]),
    },
    motor_torque=motor_torque,
)
