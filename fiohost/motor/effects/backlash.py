"""Play in the gears."""

from fiohost.motor.effect import Effect, Parameter

EFFECTS = (
    Effect(
        name="backlash",
        summary="play in the gears",
        equation="encoder_after_gap: play operator of width gap; encoder_before_gap: the share load_inertia_ratio of the "
        "inertia leaves while the gap is crossed and joins again by an inelastic impact",
        acts_on="structure",
        signature="after each reversal: a flat of fixed width in angle (encoder after the gap) or a light start and a kick",
        parameters=(
            Parameter("gap_deg", "deg", 2.0, 0.0, 90.0, step=2e-2),
            Parameter("side", "", "encoder_after_gap", neutral=None, choices=("encoder_after_gap", "encoder_before_gap")),
            Parameter("load_inertia_ratio", "of the whole", 0.3, 0.0, 0.95, neutral=None, step=2e-3),
        ),
        trials=(
            *({"gap_deg": g, "side": "encoder_after_gap", "load_inertia_ratio": 0.0} for g in (0.5, 1.0, 2.0, 4.0, 8.0)),
            *({"gap_deg": g, "side": "encoder_before_gap", "load_inertia_ratio": 0.3} for g in (1.0, 3.0, 8.0)),
        ),
        source="Nordin and Gutman, Controlling mechanical systems with backlash - a survey, Automatica 38, 2002",
    ),
)
