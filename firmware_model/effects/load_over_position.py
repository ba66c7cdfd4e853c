"""A load of any shape over the angle: a cable, a bent guide, a spring with a knee."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from firmware_model.compiled import part
from firmware_model.effect import Effect, Parameter

if TYPE_CHECKING:
    from firmware_model.plants import Plant

GIVEN = 11  # points whose torque is given; at one more it is what makes the sum zero


@part
def height(p, first, k):  # type: ignore[no-untyped-def]
    """Torque at point ``k`` of the ring, N m."""
    k %= GIVEN + 1
    if k < GIVEN:
        return p[first + k]
    rest = 0.0
    for i in range(GIVEN):
        rest += p[first + i]
    return -rest


@part
def along(theta, p, k):  # type: ignore[no-untyped-def]
    """Torque at an angle, N m: Hermite's cubic between two points, with the slopes of the chords around each."""
    place = (theta - p[k]) * (GIVEN + 1) / p[k + 1]
    left = math.floor(place)
    u = place - left
    y0, y1 = height(p, k + 2, left), height(p, k + 2, left + 1)
    m0 = 0.5 * (y1 - height(p, k + 2, left - 1))
    m1 = 0.5 * (height(p, k + 2, left + 2) - y0)
    v = 1.0 - u
    return (1.0 + 2.0 * u) * v * v * y0 + u * v * v * m0 + u * u * (3.0 - 2.0 * u) * y1 - u * u * v * m1


def load_torque(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value - along(theta, p, k)


def points() -> tuple[Parameter, ...]:
    """Where the curve begins, after which angle it repeats, and its torques."""
    return (
        Parameter("from_rad", default=0.0),
        Parameter("span_rad", default=2.0 * math.pi, lower=1e-4),
        *(Parameter(f"torque_{i}_Nm", default=0.0) for i in range(1, GIVEN + 1)),
    )


def reduced(plant: Plant, q: Mapping[str, Any]) -> dict[str, Any]:
    """The curve in degrees and percent of duty."""
    found = {"from_deg": math.degrees(q["from_rad"]), "span_deg": math.degrees(q["span_rad"])}
    return found | {f"point_{i}_pct": plant.percent_of_torque(q[f"torque_{i}_Nm"]) for i in range(1, GIVEN + 1)}


EFFECT = Effect(
    name="load_over_position",
    summary="a load that follows the angle by a curve",
    equation="T = -curve(theta), a ring of cubics through twelve points of zero sum",
    parameters=points(),
    source="Hermite interpolation; a measured load curve",
    reduced=reduced,
    load_torque=load_torque,
)
