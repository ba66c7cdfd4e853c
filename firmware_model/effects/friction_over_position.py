"""Dry friction of any shape over the angle: a guide that is tight here and loose there."""

from firmware_model.effect import Effect
from firmware_model.effects.load_over_position import along, points, reduced


def friction(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value + along(theta, p, k)


EFFECT = Effect(
    name="friction_over_position",
    summary="dry friction that follows the angle by a curve",
    equation="friction += curve(theta), a ring of cubics through twelve points of zero sum; never below 0",
    parameters=points(),
    source="Hermite interpolation; a measured friction map",
    reduced=reduced,
    stage=60,
    friction=friction,
)
