"""A lubricant that thins as it is sheared: its friction grows with the logarithm of the speed."""

import math

from firmware_model.effect import Effect, Parameter


def motor_torque(value, theta, omega, effort, side, duty, time, y, p, k, s):  # type: ignore[no-untyped-def]
    x = abs(omega) / p[k + 1]
    return value - math.copysign(p[k] * math.log(x + math.sqrt(1.0 + x * x)), omega)


EFFECT = Effect(
    name="sublinear_viscous_friction",
    summary="viscous friction that grows less than linearly",
    equation="T = -torque ln(x + sqrt(1 + x^2)) sgn(omega), x = |omega| / knee",
    parameters=(
        Parameter("torque_Nm", lower=0.0),
        Parameter("knee_rad_s", lower=1e-3),
    ),
    source="H. Eyring, Viscosity, plasticity, and diffusion as examples of absolute reaction rates, 1936",
    reduced=lambda plant, q: {
        "pct_at_1000_deg_s": plant.percent_of_torque(
            q["torque_Nm"] * math.asinh(math.radians(1000.0) / q["knee_rad_s"])
        ),
        "knee_deg_s": math.degrees(q["knee_rad_s"]),
    },
    motor_torque=motor_torque,
)
