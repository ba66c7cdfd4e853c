"""A stiff spring before break-away."""

from fiohost.motor.effect import Effect, Parameter

SMALLEST_DEG = 1e-3  # a shorter spring is a hard stick


def bristle(share, z, q):  # type: ignore[no-untyped-def]
    return z / q[0] if q[0] >= SMALLEST_DEG else share


def rate(z, omega_deg_s, current_pct, q):  # type: ignore[no-untyped-def]
    return omega_deg_s, abs(omega_deg_s) / max(q[0], SMALLEST_DEG)


EFFECTS = (
    Effect(
        name="presliding_friction",
        summary="a stiff spring before break-away (Dahl, LuGre)",
        equation="friction = level * z / breakaway; dz/dt = omega - |omega| z / breakaway",
        acts_on="friction",
        substep_s=0.00125,
        steps_a_lag=8.0,
        commonness=6,
        signature="springy motion of a few counts at reversals and below break-away",
        parameters=(Parameter("breakaway_deg", "deg", 0.5, 0.0, 30.0, step=0.01),),
        trials=({"breakaway_deg": 0.3}, {"breakaway_deg": 1.0}, {"breakaway_deg": 3.0}),
        source="P. Dahl, A solid friction model, 1968; Canudas de Wit et al., IEEE Trans. Autom. Control 40, 1995",
        bristle=bristle,
        rate=rate,
    ),
)
