"""Friction that is higher at low speed."""

import math

from firmware_model.effect import Effect, Parameter


def friction(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value + p[k] * math.exp(-((omega / p[k + 1]) ** 2))


EFFECT = Effect(
    name="stribeck_friction",
    summary="friction higher at low speed",
    equation="friction += extra exp(-(omega/stribeck_speed)^2)",
    parameters=(
        Parameter("extra_Nm", lower=0.0),
        Parameter("stribeck_speed_rad_s", lower=1e-3),
    ),
    source="Armstrong, Dupont, Canudas de Wit, Automatica 30, 1994 (Gaussian form)",
    reduced=lambda plant, q: {
        "extra_pct": plant.percent_of_torque(q["extra_Nm"]),
        "stribeck_speed_deg_s": math.degrees(q["stribeck_speed_rad_s"]),
    },
    friction=friction,
)
