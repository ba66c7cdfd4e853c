"""A dead zone whose edges differ by direction."""

from fiohost.motor.effect import Effect, Parameter


def command(duty_pct, period_s, q):  # type: ignore[no-untyped-def]
    if duty_pct > q[0]:
        return duty_pct - q[0]
    if duty_pct < q[1]:
        return duty_pct - q[1]
    return 0.0


EFFECTS = (
    Effect(
        name="asymmetric_deadband",
        summary="no effect between two levels that differ by direction",
        equation="duty_eff = duty - u_plus above u_plus, duty - u_minus below u_minus, else 0",
        acts_on="command",
        stage=31,
        commonness=5,
        signature="dead zone of different width in the two directions",
        parameters=(
            Parameter("u_plus_pct", "%", 2.0, 0.0, 90.0),
            Parameter("u_minus_pct", "%", -2.0, -90.0, 0.0),
        ),
        trials=(
            {"u_plus_pct": 2.0, "u_minus_pct": -1.0},
            {"u_plus_pct": 1.0, "u_minus_pct": -2.0},
            {"u_plus_pct": 6.0, "u_minus_pct": -3.0},
            {"u_plus_pct": 3.0, "u_minus_pct": -6.0},
        ),
        source="INC451 lab 2, Eq. 2.5",
        command=command,
    ),
)
