"""A constant torque on the output shaft, as of a hanging weight on a drum."""

from firmware_model.effect import Effect, Parameter


def load_torque(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value - p[k]


EFFECT = Effect(
    name="constant_load",
    summary="constant torque, positive when it opposes forward motion",
    equation="T_load = -torque",
    parameters=(Parameter("torque_Nm"),),
    source="Control lab appendix, section D-2 (elevator)",
    reduced=lambda plant, q: {"level_pct": plant.percent_of_torque(q["torque_Nm"])},
    load_torque=load_torque,
)
