"""A controller whose whole-number arithmetic puts a staircase on the duty."""

import math

from firmware_model.effect import Effect, Parameter

SLACK = 1e-9  # of a step, for products whose last digit is off


def command(duty, p, k):  # type: ignore[no-untyped-def]
    size, step, share = abs(duty), p[k], p[k + 1]
    if p[k + 2] == 0.0:
        stair = step * math.floor(size / step + SLACK)
    elif p[k + 2] == 1.0:
        stair = step * math.floor(size / step + (0.5 + SLACK))
    else:
        stair = step * math.ceil(size / step - SLACK)
    return math.copysign(max(min((1.0 - share) * size + share * stair, 100.0), 0.0), duty)


EFFECT = Effect(
    name="duty_steps",
    summary="a part of the duty comes in steps",
    equation="duty_eff = (1 - share) duty + share stair(duty), within 0..100 %",
    parameters=(
        Parameter("step_pct", lower=0.2, upper=60.0),
        Parameter("share", lower=-0.9, upper=0.9),
        Parameter("rounding", default=0.0, choices=("cut", "nearest", "up")),
    ),
    source="Integer division in a motor controller",
    reduced=lambda plant, q: {"step_pct": q["step_pct"], "share": q["share"], "rounding": q["rounding"]},
    stage=12,
    command=command,
)
