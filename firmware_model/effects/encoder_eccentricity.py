"""A disc off its centre, or slots unevenly cut: the error returns order times a turn."""

import math

from firmware_model.effect import Effect, Parameter


def measure(angle, p, k):  # type: ignore[no-untyped-def]
    return angle + p[k] * math.sin(p[k + 1] * angle + p[k + 2])


EFFECT = Effect(
    name="encoder_eccentricity",
    summary="measuring error, order times a turn",
    equation="angle_seen = theta + level sin(order theta + phase)",
    parameters=(
        Parameter("level_rad", lower=0.0, upper=0.5),
        Parameter("order", default=1.0, lower=1.0),
        Parameter("phase_rad", default=0.0),
    ),
    source="Encoder disc eccentricity",
    reduced=lambda plant, q: {
        "level_deg": math.degrees(q["level_rad"]),
        "order": q["order"],
        "phase_deg": math.degrees(q["phase_rad"]),
    },
    measure=measure,
)
