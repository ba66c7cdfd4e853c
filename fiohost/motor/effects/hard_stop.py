"""An end of travel."""

from collections.abc import Mapping

from fiohost.motor.effect import Effect, Parameter, Span, Value


def trials_for(span: Span) -> tuple[Mapping[str, Value], ...]:
    """A stop can only be where the shaft stood though driven on."""
    return tuple({"angle_deg": angle} for angle in span.ends_deg)


EFFECTS = (
    Effect(
        name="hard_stop",
        summary="an end of travel",
        equation="theta <= angle (angle > 0), theta >= angle (angle < 0); inelastic",
        acts_on="structure",
        commonness=6,
        angle_bound=True,
        shown=True,
        signature="speed falls to zero at one angle, whatever the drive",
        parameters=(Parameter("angle_deg", "deg", 720.0, -1e6, 1e6, neutral=None, step=0.05),),
        trials_for=trials_for,
        source="End stops of arms and lifts",
    ),
)
