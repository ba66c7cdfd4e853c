"""Friction that varies with the angle of the shaft."""

import math

from fiohost.motor.effect import Effect, Parameter


def friction(level, theta_deg, omega_deg_s, time_s, drive_pct, direction, z, q):  # type: ignore[no-untyped-def]
    return level * (1.0 + q[0] * math.sin((q[1] * theta_deg + q[2]) * (math.pi / 180.0)))


EFFECTS = (
    Effect(
        name="position_dependent_friction",
        summary="friction * (1 + ratio sin(order angle + phase))",
        equation="friction = level * (1 + ratio * sin(order * theta + phase))",
        acts_on="friction",
        stage=70,
        substep_s=0.005,
        steps_a_lag=0.0,
        commonness=6,
        angle_bound=True,
        signature="missing torque over the turn that changes sign with direction",
        parameters=(
            Parameter("ratio", "", 0.3, 0.0, 1.0, step=1e-3),
            Parameter("order", "per turn", 1.0, 1.0, 64.0, neutral=None, whole=True),
            Parameter("phase_deg", "deg", 0.0, -1e4, 1e4, neutral=None, period=360.0),
        ),
        trials=tuple({"ratio": 0.2, "order": float(n)} for n in range(1, 13)),
        couples=(("ratio", "phase_deg"),),
        source="Popovic and Goldenberg, Modeling of friction by spectral analysis, IEEE Trans. Robot. Autom. 14, 1998",
        friction=friction,
    ),
)
