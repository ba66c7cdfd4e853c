"""Drag that grows with the square of speed."""

from fiohost.motor.effect import Effect, Parameter


def torque(theta_deg, omega_deg_s, time_s, q):  # type: ignore[no-untyped-def]
    return -q[0] * omega_deg_s * abs(omega_deg_s) * 1e-6


EFFECTS = (
    Effect(
        name="quadratic_drag",
        summary="drag with speed squared",
        equation="load = pct_at_1000_deg_s * (omega / 1000 deg/s) * |omega / 1000 deg/s|",
        acts_on="torque",
        substep_s=0.005,
        steps_a_lag=8.0,
        commonness=6,
        signature="steady speed bends below a straight line at high duty, the same in both directions",
        parameters=(Parameter("pct_at_1000_deg_s", "%", 2.0, 0.0, 1000.0, by_speed=-2.0),),
        trials=({"pct_at_1000_deg_s": 2.0},),
        source="Windage of fans and brushes; Hughes and Drury, Electric Motors and Drives",
        torque=torque,
    ),
)
