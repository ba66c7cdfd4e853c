"""Errors of the encoder: eccentric disc, lost counts."""

import math

from fiohost.motor.effect import Effect, Parameter


def eccentricity(theta_deg, q):  # type: ignore[no-untyped-def]
    return theta_deg + q[0] * math.sin((q[1] * theta_deg + q[2]) * (math.pi / 180.0))


def missed(theta_deg, q):  # type: ignore[no-untyped-def]
    return theta_deg * (1.0 - q[0])


EFFECTS = (
    Effect(
        name="encoder_eccentricity",
        summary="measuring error N times a turn",
        equation="reading = theta + level * sin(order * theta + phase)",
        acts_on="measurement",
        stage=10,
        angle_bound=True,
        commonness=6,
        signature="ripple of constant size in position at any speed",
        parameters=(
            Parameter("level_deg", "deg", 1.0, 0.0, 20.0, step=1e-3),
            Parameter("order", "per turn", 1.0, 1.0, 64.0, neutral=None, whole=True),
            Parameter("phase_deg", "deg", 0.0, -1e4, 1e4, neutral=None, period=360.0),
        ),
        trials=tuple(
            {"level_deg": 0.5, "order": float(n), "phase_deg": phase}
            for n in (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 16, 20)
            for phase in (0.0, 90.0)
        ),
        linear_pairs=True,
        source="Ellin and Dolsak, The design and application of rotary encoders, Sensor Review 28, 2008",
        measure=eccentricity,
    ),
    Effect(
        name="missed_counts",
        summary="share of counts lost",
        equation="reading = (1 - ratio) * theta; equals a lower gain unless something is bound to the true angle",
        acts_on="measurement",
        stage=20,
        commonness=8,
        signature="none of its own: angles that do not close over an out-and-back run to a mark",
        parameters=(Parameter("ratio", "", 0.02, 0.0, 0.9, step=1e-4),),
        equivalents=("linear",),
        source="Slow input filters and interrupts that lose edges",
        measure=missed,
    ),
)
