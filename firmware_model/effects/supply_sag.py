"""The supply's own resistance. A capacitor at the bridge smooths a period's current, so the source carries duty * i."""

from firmware_model.effect import Effect, Parameter


def resistance(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value + p[k] * (0.01 * duty) ** 2


EFFECT = Effect(
    name="supply_sag",
    summary="supply falls with the current drawn",
    equation="V = V0 - source |duty| i, hence v = duty V0 - source duty^2 i",
    parameters=(Parameter("source_ohm", lower=0.0),),
    source="Battery and wiring resistance; averaged bridge",
    reduced=lambda plant, q: {"ratio": q["source_ohm"] / plant.R_ohm},
    resistance=resistance,
)
