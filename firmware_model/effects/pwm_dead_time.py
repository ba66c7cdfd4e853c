"""Every pulse loses a fixed time to the bridge's switching."""

import math

from firmware_model.effect import Effect, Parameter

PERIOD_S = 50e-6  # 20 kHz


def command(duty, p, k):  # type: ignore[no-untyped-def]
    if abs(duty) >= 100.0:
        return duty
    return math.copysign(max(abs(duty) - 100.0 * p[k] / PERIOD_S, 0.0), duty)


EFFECT = Effect(
    name="pwm_dead_time",
    summary="every pulse loses a fixed time; a bridge fully on has no pulses",
    equation="duty_eff = sgn(duty) max(|duty| - 100 time/50 us, 0), 100 stays 100",
    parameters=(Parameter("time_s", lower=0.0, upper=PERIOD_S),),
    source="Storage and turn-off time of a bipolar bridge at 20 kHz",
    reduced=lambda plant, q: {"time_us": 1e6 * q["time_s"]},
    stage=35,
    command=command,
)
