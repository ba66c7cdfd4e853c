"""Break-away above sliding friction."""

from firmware_model.effect import Effect, Parameter


def breakaway(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value + p[k]


EFFECT = Effect(
    name="static_friction",
    summary="break-away torque above sliding friction",
    equation="held up to friction + extra; once moving, friction",
    parameters=(Parameter("extra_Nm", lower=0.0),),
    source="Karnopp, J. Dyn. Sys. Meas. Control 107, 1985",
    reduced=lambda plant, q: {"extra_pct": plant.percent_of_torque(q["extra_Nm"])},
    breakaway=breakaway,
)
