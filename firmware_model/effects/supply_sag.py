"""The supply's own resistance.

With a capacitor at the bridge the source carries the mean of a period, duty * i; without one each pulse's own current.
"""

from firmware_model.effect import Effect, Parameter


def resistance(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    share = 0.01 * abs(duty)
    return value + p[k] * (share * share if p[k + 1] == 0.0 else share)


EFFECT = Effect(
    name="supply_sag",
    summary="supply falls with the current drawn",
    equation="v = duty (V0 - source |duty| i); without a capacitor v = duty (V0 - source i)",
    parameters=(
        Parameter("source_ohm", lower=0.0),
        Parameter("smoothing", default=0.0, choices=("capacitor", "none")),
    ),
    source="Battery and wiring resistance; averaged bridge",
    reduced=lambda plant, q: {"ratio": q["source_ohm"] / plant.R_ohm, "smoothing": q["smoothing"]},
    resistance=resistance,
)
