"""Reverse gain over forward gain."""

from fiohost.motor.effect import Effect, Parameter


def command(duty_pct, q):  # type: ignore[no-untyped-def]
    return duty_pct if duty_pct > 0.0 else duty_pct * q[0]


EFFECTS = (
    Effect(
        name="direction_dependent_gain",
        summary="reverse gain over forward gain",
        equation="duty_eff = duty forward, ratio * duty in reverse",
        acts_on="command",
        stage=60,
        signature="steady speeds differ by direction in proportion to the duty",
        parameters=(Parameter("ratio", "", 0.95, 0.2, 5.0, neutral=1.0, step=1e-4),),
        trials=({"ratio": 0.95},),
        source="Unequal halves of a bridge; brush timing",
        command=command,
    ),
)
