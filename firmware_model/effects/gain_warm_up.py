"""Magnets, brushes and bridge warm: the same duty gives more, or less, than from cold."""

from firmware_model.effect import Effect, Parameter
from firmware_model.layout import C

R, KT, SUPPLY = int(C.R), int(C.KT), int(C.SUPPLY)
RUNNING, TIME, HEAT = 0.0, 1.0, 2.0


def voltage(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value + p[k] * y[s] * value


def rate(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    if p[k + 2] == TIME:
        goal = 1.0
    elif p[k + 2] == RUNNING:
        goal = 0.0 if side == 0.0 else 1.0
    else:
        goal = (effort * p[R] / (p[KT] * p[SUPPLY])) ** 2
    return (goal - y[s]) / p[k + 1]


EFFECT = Effect(
    name="gain_warm_up",
    summary="gain that rises or falls as the motor runs or warms",
    equation="v *= 1 + ratio w, time_constant dw/dt = goal - w; goal: 1 while turning, 1 always, or (i/i_stall)^2",
    parameters=(
        Parameter("ratio", lower=-0.9, upper=5.0),
        Parameter("time_constant_s", lower=0.1),
        Parameter("follows", default=0.0, choices=("running", "time", "heat")),
    ),
    source="Temperature coefficient of ferrite magnets; first-order",
    reduced=lambda plant, q: {"ratio": q["ratio"], "time_constant_s": q["time_constant_s"], "follows": q["follows"]},
    states=1,
    voltage=voltage,
    rate=rate,
)
