"""The bridge coasts between pulses whose frequency is low: the current ceases in each period."""

from fiohost.motor.effect import Effect, Parameter


def coasts(q):  # type: ignore[no-untyped-def]
    return q[0]


EFFECTS = (
    Effect(
        name="coast_pwm",
        summary="bridge open between slow pulses: torque follows duty * (supply - emf)",
        equation="current = duty * (V - E) - a (V + E) ln(1 + (V - E) (1 - exp(-duty / a)) / (V + E)) where it ceases, "
        "(2 duty - 1) V - E where it never does; a = decay_periods",
        acts_on="current",
        substep_s=0.00125,
        commonness=4,
        signature="speed bends over the duty and goes far at low duty; the back-emf brakes by the duty's share only",
        parameters=(Parameter("decay_periods", "of a period", 0.1, 0.0, 20.0, neutral=None, step=1e-3),),
        trials=({"decay_periods": 0.02}, {"decay_periods": 0.2}, {"decay_periods": 1.0}),
        source="Erickson and Maksimovic, Fundamentals of Power Electronics, discontinuous conduction mode",
        opens=True,
        coasts=coasts,
    ),
)
