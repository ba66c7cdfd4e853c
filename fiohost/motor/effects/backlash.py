"""Play in the gears."""

from collections.abc import Mapping

from fiohost.motor.effect import Effect, Parameter, Value

_SIDES = ("encoder_after_gap", "encoder_before_gap")


def _trial(gap_deg: float, side: str, share: float) -> Mapping[str, Value]:
    return {"gap_deg": gap_deg, "side": side, "load_inertia_ratio": share}


def coupling(q):  # type: ignore[no-untyped-def]
    """A rigid contact: half the gap, and the share of the inertia beyond it; without a gap there is no second body."""
    return (q[2] if q[0] > 0.0 else 0.0), 0.5 * q[0], 0.0, 0.0


EFFECTS = (
    Effect(
        name="backlash",
        summary="play in the gears",
        equation="encoder_after_gap: play operator of width gap; encoder_before_gap: the share load_inertia_ratio of "
        "the inertia leaves while the gap is crossed and joins again by an inelastic impact",
        acts_on="structure",
        signature="after each reversal: a flat of fixed width in angle (encoder after), light start and kick (before)",
        parameters=(
            Parameter("gap_deg", "deg", 2.0, 0.0, 90.0, step=2e-2, ragged=True),
            Parameter(
                "side", "", "encoder_after_gap", neutral=None, choices=("encoder_after_gap", "encoder_before_gap")
            ),
            Parameter("load_inertia_ratio", "of the whole", 0.3, 0.0, 0.95, neutral=None, step=2e-3),
        ),
        trials=(
            *(_trial(gap, "encoder_after_gap", 0.0) for gap in (0.5, 1.0, 2.0, 4.0, 8.0)),
            *(_trial(gap, "encoder_before_gap", 0.3) for gap in (1.0, 3.0, 8.0)),
        ),
        source="Nordin and Gutman, Controlling mechanical systems with backlash - a survey, Automatica 38, 2002",
        coupling=coupling,
    ),
)
