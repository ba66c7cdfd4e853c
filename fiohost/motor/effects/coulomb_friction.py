"""Constant dry friction with true stick, the same or different by direction."""

from fiohost.motor.effect import Effect, Parameter


def friction(level, theta_deg, omega_deg_s, time_s, drive_pct, direction, z, q):  # type: ignore[no-untyped-def]
    return level + q[0]


def friction_by_direction(level, theta_deg, omega_deg_s, time_s, drive_pct, direction, z, q):  # type: ignore[no-untyped-def]
    return level + (q[0] if direction > 0.0 else q[1])


EFFECTS = (
    Effect(
        name="coulomb_friction",
        summary="constant friction opposing motion, true stick at rest",
        equation="friction = level * sgn(omega); at rest it balances any drive up to level",
        acts_on="friction",
        commonness=0,
        signature="slower in both directions by the same duty; stops dead; does not start below a level",
        parameters=(Parameter("level_pct", "%", 2.0, 0.0, 90.0),),
        trials=({"level_pct": 0.5}, {"level_pct": 2.0}, {"level_pct": 6.0}),
        source="C. A. Coulomb 1785; Olsson et al., Friction models and friction compensation, Eur. J. Control 4, 1998",
        friction=friction,
    ),
    Effect(
        name="asymmetric_coulomb_friction",
        summary="dry friction whose size differs by direction",
        equation="friction = forward where omega > 0, reverse where omega < 0; equals their mean plus a constant load",
        acts_on="friction",
        commonness=4,
        signature="the same missing torque in both directions; positions drift one way in a symmetric test",
        parameters=(
            Parameter("forward_pct", "%", 2.0, 0.0, 90.0, neutral=None),
            Parameter("reverse_pct", "%", 2.0, 0.0, 90.0, neutral=None),
        ),
        equivalents=("constant_load",),
        replaces=("coulomb_friction",),
        source="Armstrong-Helouvry, Control of Machines with Friction, 1991",
        friction=friction_by_direction,
    ),
)
