"""Viscous friction that shows apart from the back-emf: of the bearings, the same or different by direction."""

import math

from fiohost.motor.effect import Effect, Parameter

FORWARD = 0.0


def torque(theta_deg, omega_deg_s, time_s, q):  # type: ignore[no-untyped-def]
    return -q[0] * omega_deg_s * 1e-3


def one_way(theta_deg, omega_deg_s, time_s, q):  # type: ignore[no-untyped-def]
    along = omega_deg_s > 0.0 if q[1] == FORWARD else omega_deg_s < 0.0
    return -q[0] * omega_deg_s * 1e-3 if along else 0.0


def thinning(theta_deg, omega_deg_s, time_s, q):  # type: ignore[no-untyped-def]
    return -q[0] * math.asinh(omega_deg_s / q[1]) / math.asinh(1000.0 / q[1])


EFFECTS = (
    Effect(
        name="viscous_friction",
        summary="friction in proportion to speed that acts while the bridge is open too",
        equation="load = pct_at_1000_deg_s * omega / 1000 deg/s; beside it the gain is that of the back-emf alone",
        acts_on="torque",
        substep_s=0.005,
        steps_a_lag=4.0,
        commonness=5,
        signature="none while the bridge drives or brakes, where it is part of the gain; a coasting shaft slows faster",
        parameters=(Parameter("pct_at_1000_deg_s", "%", 2.0, 0.0, 1000.0, by_speed=-1.0),),
        trials=({"pct_at_1000_deg_s": 2.0},),
        source="Viscous damping of bearings and grease; Armstrong-Helouvry, Control of Machines with Friction, 1991",
        torque=torque,
    ),
    Effect(
        name="viscous_friction_by_direction",
        summary="more viscous friction in one direction",
        equation="load = pct_at_1000_deg_s * omega / 1000 deg/s where it turns in the direction, else 0",
        acts_on="torque",
        substep_s=0.005,
        steps_a_lag=4.0,
        commonness=6,
        signature="missing torque in proportion to speed in one direction only; gain and lag differ by direction",
        parameters=(
            Parameter("pct_at_1000_deg_s", "%", 2.0, 0.0, 1000.0, by_speed=-1.0),
            Parameter("direction", "", "forward", neutral=None, choices=("forward", "reverse")),
        ),
        trials=(
            {"pct_at_1000_deg_s": 2.0, "direction": "forward"},
            {"pct_at_1000_deg_s": 2.0, "direction": "reverse"},
        ),
        source="Armstrong-Helouvry, Control of Machines with Friction, 1991: coefficients by direction",
        torque=one_way,
    ),
    Effect(
        name="sublinear_viscous_friction",
        summary="viscous friction that grows less than linearly",
        equation="load = pct_at_1000_deg_s * asinh(omega / knee) / asinh(1000 deg/s / knee)",
        acts_on="torque",
        substep_s=0.0025,
        steps_a_lag=8.0,
        commonness=6,
        signature="missing torque that rises steeply at low speed and flattens, the same in both directions",
        parameters=(
            Parameter("pct_at_1000_deg_s", "%", 2.0, 0.0, 1000.0, by_speed=-0.5),
            Parameter(
                "knee_deg_s", "deg/s", 100.0, 0.01, 1e5, neutral=None, step=1e-3, relative_step=True, by_speed=1.0
            ),
        ),
        trials=tuple({"pct_at_1000_deg_s": 2.0, "knee_deg_s": v} for v in (20.0, 80.0, 300.0)),
        source="Shear thinning of lubricants; H. Eyring, J. Chem. Phys. 4, 1936",
        torque=thinning,
    ),
)
