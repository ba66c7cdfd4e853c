"""Constant dry friction with true stick."""

from fiohost.motor.effect import Effect, Parameter


def friction(theta_deg, omega_deg_s, time_s, drive_pct, direction, q):  # type: ignore[no-untyped-def]
    return q[0]


EFFECTS = (
    Effect(
        name="coulomb_friction",
        summary="constant friction opposing motion, true stick at rest",
        equation="friction = level * sgn(omega); at rest it balances any drive up to level",
        acts_on="friction",
        commonness=0,
        signature="slower in both directions by the same duty; stops dead; does not start below a level",
        parameters=(Parameter("level_pct", "%", 2.0, 0.0, 90.0, step=1e-2),),
        trials=({"level_pct": 0.5}, {"level_pct": 2.0}, {"level_pct": 6.0}),
        source="C. A. Coulomb 1785; Olsson et al., Friction models and friction compensation, Eur. J. Control 4, 1998",
        friction=friction,
    ),
)
