"""A springy coupling to a second inertia."""

from fiohost.motor.effect import Effect, Parameter

EFFECTS = (
    Effect(
        name="shaft_compliance",
        summary="springy coupling to a second inertia",
        equation="two inertias, resonance (2 pi f)**2 = k / (J r (1 - r)), relative damping, r the share of the load",
        acts_on="structure",
        substep_s=0.001,
        signature="ringing of fixed frequency after steps",
        parameters=(
            Parameter("resonance_hz", "Hz", 12.0, 1.0, 80.0, neutral=None, step=1e-3, relative_step=True),
            Parameter("damping_ratio", "", 0.05, 0.0, 2.0, neutral=None, step=1e-4),
            Parameter("inertia_ratio", "of the whole", 0.3, 0.0, 0.95, step=1e-4),
        ),
        trials=tuple(
            {"resonance_hz": f, "damping_ratio": 0.05, "inertia_ratio": 0.25} for f in (4.0, 6.0, 9.0, 13.0, 19.0, 28.0)
        ),
        source="Two-mass drives; Schroeder, Elektrische Antriebe",
    ),
)
