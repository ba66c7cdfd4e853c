"""Friction of loaded gear teeth."""

from firmware_model.effect import Effect, Parameter


def friction(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value + p[k] * abs(effort)


EFFECT = Effect(
    name="load_dependent_friction",
    summary="friction growing with the torque that the gears transmit",
    equation="friction += ratio |Kt i|",
    parameters=(Parameter("ratio", lower=0.0, upper=0.9),),
    source="Rhoban BAM, friction model M3 (gearbox load)",
    reduced=lambda plant, q: {"ratio": q["ratio"]},
    friction=friction,
)
