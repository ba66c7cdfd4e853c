"""A constant torque on the shaft."""

from fiohost.motor.effect import Effect, Parameter


def load(theta_deg, omega_deg_s, time_s, q):  # type: ignore[no-untyped-def]
    return -q[0]


EFFECTS = (
    Effect(
        name="constant_load",
        summary="constant torque, positive when it opposes forward motion",
        equation="load = level",
        acts_on="torque",
        commonness=4,
        drives=True,
        signature="the same missing torque in both directions; positions drift one way in a symmetric test",
        parameters=(Parameter("level_pct", "%", 1.0, -90.0, 90.0, step=1e-2),),
        trials=({"level_pct": 1.0},),
        equivalents=("asymmetric_coulomb_friction",),
        source="Elevator and bias loads; control lab appendix, section D-2",
        load=load,
    ),
)
