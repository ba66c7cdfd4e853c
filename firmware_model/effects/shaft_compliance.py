"""A springy coupling to a second inertia. With play in series the spring only pushes, beyond the gap."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from firmware_model.effect import Effect, Parameter

if TYPE_CHECKING:
    from firmware_model.plants import Plant


def reduced(plant: Plant, q: Mapping[str, Any]) -> dict[str, Any]:
    """Resonance of the two free bodies, its damping ratio, and the load's inertia over the whole."""
    load = q["load_inertia_kgm2"]
    inverse = 1.0 / load + 1.0 / (plant.J_kgm2 - load)
    natural = math.sqrt(q["stiffness_Nm_per_rad"] * inverse)
    return {
        "resonance_hz": natural / (2.0 * math.pi),
        "damping_ratio": q["damping_Nms"] * inverse / (2.0 * natural),
        "inertia_ratio": load / plant.J_kgm2,
        "side": q["side"],
    }


EFFECT = Effect(
    name="shaft_compliance",
    summary="springy coupling between the motor and a second inertia",
    equation="T = stiffness twist + damping d(twist)/dt, twist = theta_m - theta_l",
    parameters=(
        Parameter("stiffness_Nm_per_rad", lower=1e-6),
        Parameter("damping_Nms", default=0.0, lower=0.0),
        Parameter("load_inertia_kgm2", lower=1e-9),
        Parameter("side", default=1.0, choices=("encoder_after_spring", "encoder_before_spring")),
    ),
    source="Two-mass drive; Ellis, Control System Design Guide",
    reduced=reduced,
    structure=lambda plant, q: {
        "STIFFNESS": q["stiffness_Nm_per_rad"],
        "DAMPING": q["damping_Nms"],
        "LOAD_J": q["load_inertia_kgm2"],
        "AFTER": float(q["side"] == "encoder_after_spring"),
    },
)
