"""The drive gives no more above a level of duty."""

from firmware_model.effect import Effect, Parameter


def command(duty, p, k):  # type: ignore[no-untyped-def]
    return min(max(duty, -p[k]), p[k])


EFFECT = Effect(
    name="voltage_saturation",
    summary="no more effect above a level of duty",
    equation="duty_eff = clip(duty, -limit, limit)",
    parameters=(Parameter("limit_pct", lower=1.0, upper=100.0),),
    source="INC451 lab 2, Fig. 2.18",
    reduced=lambda plant, q: {"limit_pct": q["limit_pct"]},
    stage=40,
    command=command,
)
