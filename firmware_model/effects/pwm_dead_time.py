"""Every pulse loses a fixed time to the bridge's switching."""

import math

from firmware_model.effect import Effect, Parameter
from firmware_model.layout import C

PERIOD, LONGEST_S = int(C.PERIOD), 1e-3


def command(duty, p, k):  # type: ignore[no-untyped-def]
    if abs(duty) >= 100.0:
        return duty
    return math.copysign(max(abs(duty) - 100.0 * p[k] / p[PERIOD], 0.0), duty)


EFFECT = Effect(
    name="pwm_dead_time",
    summary="every pulse loses a fixed time; a bridge fully on has no pulses",
    equation="duty_eff = sgn(duty) max(|duty| - 100 time f, 0) at a PWM of f, 100 stays 100",
    parameters=(Parameter("time_s", lower=0.0, upper=LONGEST_S),),
    source="Storage and turn-off time of a bipolar bridge",
    reduced=lambda plant, q: {"time_us": 1e6 * q["time_s"]},
    stage=35,
    command=command,
)
