"""The driver limits the current."""

from firmware_model.effect import Effect, Parameter


def ceiling(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return min(value, p[k])


EFFECT = Effect(
    name="current_limit",
    summary="the driver lets no more current through than its limit",
    equation="|i| <= limit",
    parameters=(Parameter("limit_A", lower=1e-3),),
    source="LB1836M: 1.0 A a channel",
    reduced=lambda plant, q: {"limit_pct": 100.0 * q["limit_A"] * plant.R_ohm / plant.supply_V},
    ceiling=ceiling,
)
