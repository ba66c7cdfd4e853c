"""The reverse branch of the bridge gives another voltage."""

from firmware_model.effect import Effect, Parameter


def voltage(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value * p[k] if duty < 0.0 else value


EFFECT = Effect(
    name="direction_dependent_gain",
    summary="reverse gain over forward gain",
    equation="v *= ratio where duty < 0",
    parameters=(Parameter("ratio", lower=0.05, upper=20.0),),
    source="Unequal bridge branches, brush shift",
    reduced=lambda plant, q: {"ratio": q["ratio"]},
    voltage=voltage,
)
