"""The winding warms with its losses and its resistance follows."""

from firmware_model.effect import Effect, Parameter
from firmware_model.layout import C

R, KT = int(C.R), int(C.KT)


def resistance(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value * (1.0 + p[k] * y[s])


def rate(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    current = effort / p[KT]
    loss = current * current * p[R] * (1.0 + p[k] * y[s])
    return (loss * p[k + 1] - y[s]) / p[k + 2]


EFFECT = Effect(
    name="armature_heating",
    summary="resistance follows the winding's warmth",
    equation="R = R0 (1 + alpha dT), time_constant d(dT)/dt = thermal i^2 R - dT",
    parameters=(
        Parameter("alpha_per_K", default=0.0039, lower=0.0),
        Parameter("thermal_K_per_W", lower=0.0),
        Parameter("time_constant_s", lower=0.1),
    ),
    source="Copper, 0.39 % per kelvin; first-order thermal model",
    reduced=lambda plant, q: {
        # Rise of the resistance, kept at stall on full duty, if the losses stayed those of the cold winding.
        "rise_ratio": q["alpha_per_K"] * q["thermal_K_per_W"] * plant.supply_V**2 / plant.R_ohm,
        "time_constant_s": q["time_constant_s"],
    },
    stage=40,
    states=1,
    resistance=resistance,
    rate=rate,
)
