"""The bridge's transistors and diodes lose a voltage against the current."""

from firmware_model.effect import Effect, Parameter


def drop(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value + p[k]


EFFECT = Effect(
    name="bridge_voltage_drop",
    summary="a voltage lost in the bridge, opposing the current",
    equation="v -= drop sgn(i); no current while |v - Ke omega| <= drop",
    parameters=(Parameter("drop_V", lower=0.0),),
    source="LB1836M: 0.40 V upper plus lower at 0.40 A",
    reduced=lambda plant, q: {"drop_pct": 100.0 * q["drop_V"] / plant.supply_V},
    drop=drop,
)
