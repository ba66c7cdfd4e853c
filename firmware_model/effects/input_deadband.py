"""Below a level of mean voltage the drive gives nothing (the lab text's dead zone)."""

from firmware_model.effect import Effect, Parameter


def command(duty, p, k):  # type: ignore[no-untyped-def]
    if duty > p[k]:
        return duty - p[k]
    if duty < -p[k]:
        return duty + p[k]
    return 0.0


EFFECT = Effect(
    name="input_deadband",
    summary="no effect below a level of duty, and that much less above it",
    equation="duty_eff = sgn(duty) max(|duty| - level, 0)",
    parameters=(Parameter("level_pct", lower=0.0, upper=99.0),),
    source="INC451 lab 2, Eq. 2.5, with u+ = -u-",
    reduced=lambda plant, q: {"level_pct": q["level_pct"]},
    stage=30,
    command=command,
)
