"""A disc off its centre, tilted and oval: the error returns once, twice and three times a turn."""

import math

from firmware_model.effect import Effect, Parameter


def measure(angle, p, k):  # type: ignore[no-untyped-def]
    off = p[k] * math.sin(angle + p[k + 1]) + p[k + 2] * math.sin(2.0 * angle + p[k + 3])
    return angle + off + p[k + 4] * math.sin(3.0 * angle + p[k + 5])


EFFECT = Effect(
    name="shaft_angle_error",
    summary="measuring error locked to the shaft, orders 1 to 3",
    equation="angle_seen = theta + level_1 sin(theta + phase_1) + ... + level_3 sin(3 theta + phase_3)",
    parameters=tuple(
        q
        for n in (1, 2, 3)
        for q in (
            Parameter(f"level_{n}_rad", default=0.0, lower=0.0, upper=0.3),
            Parameter(f"phase_{n}_rad", default=0.0),
        )
    ),
    source="Encoder disc eccentricity and tilt",
    reduced=lambda plant, q: {key.removesuffix("rad") + "deg": math.degrees(value) for key, value in q.items()},
    measure=measure,
)
