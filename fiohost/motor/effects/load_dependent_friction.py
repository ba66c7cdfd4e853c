"""Friction that grows with the torque that the gears transmit."""

from fiohost.motor.effect import Effect, Parameter


def friction(level, theta_deg, omega_deg_s, time_s, drive_pct, direction, z, q):  # type: ignore[no-untyped-def]
    return level + q[0] * abs(drive_pct)


EFFECTS = (
    Effect(
        name="load_dependent_friction",
        summary="friction growing with transmitted torque",
        equation="friction = level + ratio * |motor torque|",
        acts_on="friction",
        stage=10,
        substep_s=0.0025,
        steps_a_lag=8.0,
        signature="more friction while accelerating and braking than at steady speed",
        parameters=(Parameter("ratio", "", 0.1, 0.0, 0.95, step=1e-4),),
        trials=({"ratio": 0.1},),
        source="Duclusaud et al., Extended friction models for servo actuators, 2024 (model M3)",
        friction=friction,
    ),
)
