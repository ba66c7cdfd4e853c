"""An eccentric weight on a horizontal shaft."""

import math

from fiohost.motor.effect import Effect, Parameter


def load(theta_deg, omega_deg_s, time_s, q):  # type: ignore[no-untyped-def]
    return -q[0] * math.sin((theta_deg + q[1]) * (math.pi / 180.0))


EFFECTS = (
    Effect(
        name="gravity_load",
        summary="eccentric weight, once a turn",
        equation="load = level * sin(theta + phase)",
        acts_on="torque",
        substep_s=0.0025,
        steps_a_lag=0.0,
        angle_bound=True,
        signature="missing torque once a turn, the same curve in both directions",
        parameters=(
            Parameter("level_pct", "%", 3.0, 0.0, 90.0, step=1e-2),
            Parameter("phase_deg", "deg", 0.0, -1e4, 1e4, neutral=None, step=1e-2, period=360.0),
        ),
        trials=({"level_pct": 1.0},),
        couples=(("level_pct", "phase_deg"),),
        equivalents=("cogging_torque",),
        source="Pendulum on a motor shaft; control lab appendix, arm and payload, section D-1-6",
        load=load,
    ),
)
