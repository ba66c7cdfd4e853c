"""A voltage lost in the bridge, opposing the current."""

from fiohost.motor.effect import Effect, Parameter


def drop(q):  # type: ignore[no-untyped-def]
    return q[0]


EFFECTS = (
    Effect(
        name="bridge_voltage_drop",
        summary="a voltage lost, opposing the current",
        equation="current = duty - emf - drop * sgn(current); none while |duty - emf| <= drop",
        acts_on="current",
        substep_s=0.0025,
        commonness=3,
        signature="like dry friction while driving, the other way round while braking by the motor",
        parameters=(Parameter("drop_pct", "%", 2.0, 0.0, 50.0),),
        trials=({"drop_pct": 1.0}, {"drop_pct": 4.0}),
        source="Saturation voltage of bipolar bridges, LB1836M data sheet",
        drop=drop,
    ),
)
