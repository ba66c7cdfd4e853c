"""Dry friction whose size differs by direction; it comes on top of the plant's constant one."""

from firmware_model.effect import Effect, Parameter


def friction(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    if side > 0.0:
        return value + p[k]
    if side < 0.0:
        return value + p[k + 1]
    return value + 0.5 * (p[k] + p[k + 1])


EFFECT = Effect(
    name="asymmetric_coulomb_friction",
    summary="dry friction of different size by direction",
    equation="friction += forward if sliding forward else reverse",
    parameters=(
        Parameter("forward_Nm", lower=0.0),
        Parameter("reverse_Nm", lower=0.0),
    ),
    source="Armstrong, Dupont, Canudas de Wit, Automatica 30, 1994",
    reduced=lambda plant, q: {
        "forward_pct": plant.percent_of_torque(q["forward_Nm"]),
        "reverse_pct": plant.percent_of_torque(q["reverse_Nm"]),
    },
    friction=friction,
)
