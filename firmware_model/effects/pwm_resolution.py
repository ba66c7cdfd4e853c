"""A timer with few steps: the duty is rounded, or cut, to one of its levels."""

import math

from firmware_model.effect import Effect, Parameter

# A duty of the timer may lie just between two levels: it goes up, whatever the last digit of the product says.
TIE = 1e-9
CUT = 0.0


def command(duty, p, k):  # type: ignore[no-untyped-def]
    more = TIE if p[k + 1] == CUT else 0.5 + TIE
    return math.copysign(math.floor(0.01 * abs(duty) * p[k] + more) / p[k] * 100.0, duty)


EFFECT = Effect(
    name="pwm_resolution",
    summary="coarse duty steps",
    equation="duty_eff = 100 n/levels, n = duty/100 levels rounded or cut",
    parameters=(
        Parameter("levels", lower=1.0, upper=100000.0),
        Parameter("rounding", default=1.0, choices=("cut", "nearest")),
    ),
    source="Timer resolution; 8-bit PWM has 255 levels",
    reduced=lambda plant, q: {"levels": q["levels"], "rounding": q["rounding"]},
    stage=10,
    command=command,
)
