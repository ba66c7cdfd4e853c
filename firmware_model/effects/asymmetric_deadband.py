"""A dead zone of different size by direction."""

from firmware_model.effect import Effect, Parameter


def command(duty, p, k):  # type: ignore[no-untyped-def]
    if duty > p[k]:
        return duty - p[k]
    if duty < p[k + 1]:
        return duty - p[k + 1]
    return 0.0


EFFECT = Effect(
    name="asymmetric_deadband",
    summary="no effect below a level that differs by direction",
    equation="duty_eff = duty - u_plus above u_plus, duty - u_minus below u_minus, else 0",
    parameters=(
        Parameter("u_plus_pct", lower=0.0, upper=99.0),
        Parameter("u_minus_pct", lower=-99.0, upper=0.0),
    ),
    source="INC451 lab 2, Eq. 2.5",
    reduced=lambda plant, q: {"u_plus_pct": q["u_plus_pct"], "u_minus_pct": q["u_minus_pct"]},
    stage=31,
    command=command,
)
