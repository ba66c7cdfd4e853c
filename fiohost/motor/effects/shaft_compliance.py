"""A springy coupling to a second inertia."""

import math

from fiohost.motor.effect import Effect, Parameter

SIDES = ("encoder_before_spring", "encoder_after_spring")


def coupling(q):  # type: ignore[no-untyped-def]
    return q[2], 0.0, 2.0 * math.pi * q[0], q[1]


EFFECTS = (
    Effect(
        name="shaft_compliance",
        summary="springy coupling to a second inertia",
        equation="two inertias, resonance (2 pi f)**2 = k / (J r (1 - r)), relative damping, r the share of the load",
        acts_on="structure",
        signature="ringing of fixed frequency after steps",
        parameters=(
            Parameter("resonance_hz", "Hz", 12.0, 1.0, 80.0, neutral=None, step=1e-3, relative_step=True),
            Parameter("damping_ratio", "", 0.05, 0.0, 2.0, neutral=None, step=1e-4),
            Parameter("inertia_ratio", "of the whole", 0.3, 0.0, 0.95, step=1e-4),
            Parameter("side", "", SIDES[0], neutral=None, choices=SIDES),
        ),
        trials=tuple(
            {"resonance_hz": f, "damping_ratio": 0.05, "inertia_ratio": 0.25, "side": side}
            for side in SIDES
            for f in (4.0, 6.0, 9.0, 13.0, 19.0, 28.0)
        ),
        source="Two-mass drives; Schroeder, Elektrische Antriebe",
        coupling=coupling,
    ),
)
