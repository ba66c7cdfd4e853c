"""Resistance follows the winding's warmth."""

from fiohost.motor.effect import Effect, Parameter


def resistance(ohms, duty_pct, z, q):  # type: ignore[no-untyped-def]
    return ohms * (1.0 + q[0] * z)


def rate(z, omega_deg_s, current_pct, q):  # type: ignore[no-untyped-def]
    """The losses are those of the hot winding."""
    cold_loss = (current_pct / 100.0) ** 2
    return cold_loss / q[1], (1.0 - q[0] * cold_loss) / q[1]


EFFECTS = (
    Effect(
        name="armature_heating",
        summary="resistance follows the winding's warmth",
        equation="current = (duty - emf) / (1 + rise_ratio * h); "
        "dh/dt = ((current / stall)**2 * (1 + rise_ratio * h) - h) / time_constant",
        acts_on="current",
        stage=20,
        substep_s=0.005,
        steps_a_lag=4.0,
        signature="gain falls after loaded phases and recovers at rest",
        parameters=(
            Parameter("rise_ratio", "", 0.5, 0.0, 20.0, step=1e-3),
            Parameter("time_constant_s", "s", 10.0, 0.5, 1000.0, neutral=None, step=1e-3, relative_step=True),
        ),
        warms=True,
        trials=tuple({"rise_ratio": 1.0, "time_constant_s": t} for t in (3.0, 10.0, 40.0)),
        source="Isermann, Fault-Diagnosis Applications, DC motor; copper 0.39 % per kelvin",
        resistance=resistance,
        rate=rate,
    ),
)
