"""Something that swings by the clock: hum of the supply, a program's slow task, a bench that shakes."""

import math

from firmware_model.effect import Effect, Parameter
from firmware_model.layout import C

KT, R, SUPPLY = int(C.KT), int(C.R), int(C.SUPPLY)
TORQUE, GAIN = 0.0, 1.0


def motor_torque(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    if p[k + 3] != TORQUE:
        return value
    stall = p[KT] * p[SUPPLY] / p[R]
    return value + p[k] * stall * math.sin(2.0 * math.pi * p[k + 1] * time + p[k + 2])


def voltage(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    if p[k + 3] != GAIN:
        return value
    return value + value * p[k] * math.sin(2.0 * math.pi * p[k + 1] * time + p[k + 2])


EFFECT = Effect(
    name="clock_ripple",
    summary="torque or gain swings at a fixed frequency",
    equation="T += ratio T_stall sin(2 pi f t + phase), or v *= 1 + ratio sin(2 pi f t + phase)",
    parameters=(
        Parameter("ratio", lower=0.0, upper=0.9),
        Parameter("frequency_Hz", lower=0.01, upper=100.0),
        Parameter("phase_rad", default=0.0),
        Parameter("of", default=0.0, choices=("torque", "gain")),
    ),
    source="Supply hum; periodic tasks",
    reduced=lambda plant, q: {
        "level_pct": 100.0 * q["ratio"],
        "frequency_hz": q["frequency_Hz"],
        "phase_deg": math.degrees(q["phase_rad"]),
        "of": q["of"],
    },
    motor_torque=motor_torque,
    voltage=voltage,
)
