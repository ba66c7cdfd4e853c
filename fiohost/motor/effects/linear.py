"""The linear servo: gain and lag from duty to speed."""

from fiohost.motor.effect import Effect, Parameter

EFFECTS = (
    Effect(
        name="linear",
        summary="gain and lag from duty to speed",
        equation="tau * domega/dt = K * (duty - loads - friction) - omega",
        acts_on="structure",
        parameters=(
            Parameter(
                "gain_deg_s_per_pct", "deg/s per %", 10.0, 1e-9, 1e6, neutral=None, step=1e-5, relative_step=True
            ),
            Parameter("tau_s", "s", 0.08, 1e-4, 100.0, neutral=None, step=1e-5, relative_step=True),
        ),
        source="Armature-controlled DC motor with negligible inductance; K/(s (tau s + 1)), INC451 lab 2, Eq. 2.4",
    ),
)
