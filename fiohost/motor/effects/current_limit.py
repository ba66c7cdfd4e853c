"""The driver limits the current."""

from fiohost.motor.effect import Effect, Parameter


def ceiling(q):  # type: ignore[no-untyped-def]
    return q[0]


EFFECTS = (
    Effect(
        name="current_limit",
        summary="torque limited, in percent of stall at full duty",
        equation="|current| <= limit at every instant; a winding without lag knows the mean of a PWM period alone",
        acts_on="current",
        substep_s=0.0025,
        commonness=4,
        signature="the first moments of large steps and reversals are slower, steady speeds are not",
        parameters=(Parameter("limit_pct", "%", 70.0, 2.0, 200.0, neutral=200.0),),
        trials=tuple({"limit_pct": limit} for limit in (130.0, 100.0, 80.0, 60.0, 45.0, 30.0, 20.0)),
        source="Control lab appendix, Fig. D-5, current saturation",
        ceiling=ceiling,
    ),
)
