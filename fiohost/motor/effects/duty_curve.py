"""Speed that is not proportional to duty."""

from fiohost.motor.effect import Effect, Parameter


def command(duty_pct, period_s, q):  # type: ignore[no-untyped-def]
    size = 100.0 * (abs(duty_pct) * 0.01) ** q[0]
    return size if duty_pct > 0.0 else -size


EFFECTS = (
    Effect(
        name="duty_curve",
        summary="speed not proportional to duty",
        equation="duty_eff = 100 % * sgn(duty) * (|duty| / 100 %) ** exponent",
        acts_on="command",
        stage=20,
        commonness=5,
        signature="curvature that follows the duty, not the speed",
        parameters=(Parameter("exponent", "", 1.1, 0.2, 5.0, neutral=1.0, step=1e-4),),
        trials=({"exponent": 1.1}, {"exponent": 0.9}),
        source="Hammerstein models; Kara and Eker, Nonlinear modeling of a DC motor, Energy Convers. Manag. 45, 2004",
        command=command,
    ),
)
