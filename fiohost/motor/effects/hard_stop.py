"""An end of travel."""

from collections.abc import Mapping

from fiohost.motor.effect import Effect, Kind, Parameter, Span, Value


def trials_for(span: Span) -> tuple[Mapping[str, Value], ...]:
    """A stop can only be where the shaft stood though driven on."""
    return tuple({"angle_deg": angle} for angle in span.ends_deg)


def event(theta_deg, omega_deg_s, q):  # type: ignore[no-untyped-def]
    return q[0] - theta_deg if q[0] > 0.0 else theta_deg - q[0]


def jump(theta_deg, omega_deg_s, q):  # type: ignore[no-untyped-def]
    return q[0], 0.0


def bars(theta_deg, direction, q):  # type: ignore[no-untyped-def]
    return theta_deg == q[0] and direction * q[0] > 0.0


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
        parameters=(Parameter("angle_deg", "deg", 720.0, -1e6, 1e6, neutral=None, step=0.05, special=Kind.EVENT),),
        trials_for=trials_for,
        source="End stops of arms and lifts",
        event=event,
        jump=jump,
        bars=bars,
    ),
)
