"""An eccentric weight on a horizontal shaft."""

import math

from firmware_model.effect import Effect, Parameter


def load_torque(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    return value - p[k] * math.sin(theta + p[k + 1])


EFFECT = Effect(
    name="gravity_load",
    summary="eccentric weight: torque = m g r, once a turn",
    equation="T_load = -torque sin(theta + phase)",
    parameters=(Parameter("torque_Nm", lower=0.0), Parameter("phase_rad", default=0.0)),
    source="Pendulum on the shaft; mechanics",
    reduced=lambda plant, q: {
        "level_pct": plant.percent_of_torque(q["torque_Nm"]),
        "phase_deg": math.degrees(q["phase_rad"]),
    },
    load_torque=load_torque,
)
