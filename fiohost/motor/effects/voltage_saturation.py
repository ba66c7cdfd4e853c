"""The drive gives no more above a level of duty."""

from fiohost.motor.effect import Effect, Parameter


def command(duty_pct, period_s, q):  # type: ignore[no-untyped-def]
    return min(max(duty_pct, -q[0]), q[0])


EFFECTS = (
    Effect(
        name="voltage_saturation",
        summary="no more effect above a level",
        equation="duty_eff = clip(duty, -limit, limit)",
        acts_on="command",
        commonness=4,
        stage=40,
        signature="steady speed flat above one duty, unchanged below it",
        parameters=(Parameter("limit_pct", "%", 80.0, 1.0, 100.0, neutral=100.0, step=1e-2),),
        trials=tuple({"limit_pct": limit} for limit in (95.0, 85.0, 75.0, 65.0, 55.0, 45.0, 35.0, 25.0)),
        source="INC451 lab 2, Fig. 2.18; control lab appendix, section D-1",
        command=command,
    ),
)
