"""A load picked up, a supply switched: one constant changes during the run."""

from firmware_model.effect import Effect, Parameter
from firmware_model.layout import C

CHANGED = int(C.CHANGED)
INERTIA, FRICTION, GAIN = 0.0, 1.0, 2.0


def inertia(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    if p[CHANGED] > 0.0 and p[k + 1] == INERTIA:
        return value * p[k + 2]
    return value


def friction(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    if p[CHANGED] > 0.0 and p[k + 1] == FRICTION:
        return value * p[k + 2]
    return value


def voltage(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    if p[CHANGED] > 0.0 and p[k + 1] == GAIN:
        return value * p[k + 2]
    return value


EFFECT = Effect(
    name="parameter_change",
    summary="inertia, friction or gain changes during the run",
    equation="from time on: which *= ratio",
    parameters=(
        Parameter("time_s", lower=0.0),
        Parameter("which", default=0.0, choices=("inertia", "friction", "gain")),
        Parameter("ratio", lower=0.01, upper=100.0),
    ),
    source="Event in the plant",
    reduced=lambda plant, q: {"time_s": q["time_s"], "which": q["which"], "ratio": q["ratio"]},
    stage=90,
    structure=lambda plant, q: {"CHANGE_AT": q["time_s"]},
    inertia=inertia,
    friction=friction,
    voltage=voltage,
)
