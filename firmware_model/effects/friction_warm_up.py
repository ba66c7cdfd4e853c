"""Grease that softens as it runs."""

from firmware_model.effect import Effect, Parameter


def friction(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value * (1.0 - p[k] * y[s])


def rate(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return ((1.0 if side != 0.0 else 0.0) - y[s]) / p[k + 1]


EFFECT = Effect(
    name="friction_warm_up",
    summary="friction falls as the motor runs and returns at rest",
    equation="friction *= 1 - ratio w, time_constant dw/dt = (1 while turning, 0 at rest) - w",
    parameters=(
        Parameter("ratio", lower=0.0, upper=1.0),
        Parameter("time_constant_s", lower=0.1),
    ),
    source="Run-in of gear grease; first-order",
    reduced=lambda plant, q: {"ratio": q["ratio"], "time_constant_s": q["time_constant_s"]},
    stage=80,
    states=1,
    friction=friction,
    rate=rate,
)
