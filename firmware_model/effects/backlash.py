"""Play in the gears between the motor and its load.

With a load inertia the two bodies move apart in the gap and meet in a rigid, inelastic impact: momentum is kept, the
faces stay together until the contact force would have to pull. That is the limit of a stiff, well damped tooth; it
adds no stiffness nobody knows. Without load inertia the far side is a disc of no mass, held by the slightest
friction: play. The motor's friction stays on the motor's side; loads (weight, gravity) act beyond the gap.
"""

import math

from firmware_model.effect import Effect, Parameter

EFFECT = Effect(
    name="backlash",
    summary="play in the gears, with the encoder on the load's or on the motor's side of it",
    equation="|theta_m - theta_l| <= gap/2; force only pushes; at impact omega = (Jm omega_m + Jl omega_l)/(Jm + Jl)",
    parameters=(
        Parameter("gap_rad", lower=0.0, upper=math.pi),
        Parameter("side", default=0.0, choices=("encoder_after_gap", "encoder_before_gap")),
        Parameter("load_inertia_kgm2", default=0.0, lower=0.0),
    ),
    source="Nordin and Gutman, Controlling mechanical systems with backlash - a survey, Automatica 38, 2002",
    reduced=lambda plant, q: {
        "gap_deg": math.degrees(q["gap_rad"]),
        "side": q["side"],
        "load_inertia_ratio": q["load_inertia_kgm2"] / plant.J_kgm2,
    },
    structure=lambda plant, q: {
        "HALF_GAP": 0.5 * q["gap_rad"],
        "AFTER": float(q["side"] == "encoder_after_gap"),
        "LOAD_J": q["load_inertia_kgm2"],
    },
)
