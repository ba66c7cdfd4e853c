"""A battery that discharges (or recovers), whatever is done."""

from firmware_model.effect import Effect, Parameter


def voltage(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value * max(1.0 + p[k] * time, 0.0)


EFFECT = Effect(
    name="supply_drift",
    summary="the supply drifts with the time since power-on",
    equation="v *= 1 + drift t",
    parameters=(Parameter("drift_per_s", lower=-1.0, upper=1.0),),
    source="Battery discharge",
    reduced=lambda plant, q: {"pct_per_100_s": 1e4 * q["drift_per_s"]},
    voltage=voltage,
)
