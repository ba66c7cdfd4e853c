"""Torque ripple that is locked to the angle."""

import math

from fiohost.motor.effect import Effect, Parameter


def torque(theta_deg, omega_deg_s, time_s, q):  # type: ignore[no-untyped-def]
    return -q[1] * math.sin((q[0] * theta_deg + q[2]) * (math.pi / 180.0))


EFFECTS = (
    Effect(
        name="cogging_torque",
        summary="ripple N times a turn",
        equation="load = level * sin(order * theta + phase)",
        acts_on="torque",
        substep_s=0.005,
        steps_a_lag=0.0,
        angle_bound=True,
        signature="a line in the spectrum over the angle; its effect on the position falls with speed squared",
        parameters=(
            Parameter("order", "per turn", 4.0, 1.0, 64.0, neutral=None, whole=True),
            Parameter("level_pct", "%", 2.0, 0.0, 90.0),
            Parameter("phase_deg", "deg", 0.0, -1e4, 1e4, neutral=None, period=360.0),
        ),
        trials=tuple({"order": float(n), "level_pct": 1.0} for n in (*range(2, 21), 24, 30, 36, 40, 48)),
        couples=(("level_pct", "phase_deg"),),
        equivalents=("gravity_load",),
        source="Jahns and Soong, Pulsating torque minimization, IEEE Trans. Ind. Electron. 43, 1996",
        torque=torque,
    ),
)
