"""Duty below a level has no effect: the lab text's model of the dead zone."""

from fiohost.motor.effect import Effect, Parameter


def command(duty_pct, period_s, q):  # type: ignore[no-untyped-def]
    if duty_pct > q[0]:
        return duty_pct - q[0]
    if duty_pct < -q[0]:
        return duty_pct + q[0]
    return 0.0


EFFECTS = (
    Effect(
        name="input_deadband",
        summary="no effect below a level (the lab text's model)",
        equation="duty_eff = sgn(duty) * max(|duty| - level, 0)",
        acts_on="command",
        commonness=3,
        stage=30,
        signature="differs from dry friction only while it turns against its command: run-down, braking, reversal",
        parameters=(Parameter("level_pct", "%", 2.0, 0.0, 90.0, step=1e-2),),
        trials=({"level_pct": 0.5}, {"level_pct": 2.0}, {"level_pct": 6.0}),
        source="INC451 lab 2, Eq. 2.5 with u+ = -u-",
        command=command,
    ),
)
