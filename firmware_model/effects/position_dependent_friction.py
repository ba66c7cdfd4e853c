"""Friction that varies round the turn (bent shaft, uneven teeth)."""

import math

from firmware_model.effect import Effect, Parameter


def friction(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value * (1.0 + p[k] * math.sin(p[k + 1] * theta + p[k + 2]))


EFFECT = Effect(
    name="position_dependent_friction",
    summary="friction varying with the angle",
    equation="friction *= 1 + ratio sin(order theta + phase)",
    parameters=(
        Parameter("ratio", lower=0.0, upper=1.0),
        Parameter("order", default=1.0, lower=1.0),
        Parameter("phase_rad", default=0.0),
    ),
    source="Armstrong-Helouvry, Control of Machines with Friction, 1991",
    reduced=lambda plant, q: {"ratio": q["ratio"], "order": q["order"], "phase_deg": math.degrees(q["phase_rad"])},
    stage=70,
    friction=friction,
)
