"""Mean voltage not proportional to duty."""

import math

from firmware_model.effect import Effect, Parameter


def command(duty, p, k):  # type: ignore[no-untyped-def]
    return math.copysign(100.0 * (0.01 * abs(duty)) ** p[k], duty)


EFFECT = Effect(
    name="duty_curve",
    summary="mean voltage not proportional to duty",
    equation="duty_eff = 100 sgn(duty) (|duty|/100)^exponent",
    parameters=(Parameter("exponent", lower=0.2, upper=5.0),),
    source="Static nonlinearity of a drive; Hammerstein models",
    reduced=lambda plant, q: {"exponent": q["exponent"]},
    stage=20,
    command=command,
)
