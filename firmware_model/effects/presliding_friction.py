"""A stiff spring before break-away: Dahl's model. It replaces the hard stick of dry friction.

The bristle's deflection z is a state of the kernel; the friction torque is the sliding level times z over breakaway.
"""

import math

from firmware_model.effect import Effect, Parameter

EFFECT = Effect(
    name="presliding_friction",
    summary="dry friction acts through a stiff spring before break-away",
    equation="T = -friction z/breakaway, dz/dt = omega (1 - sgn(omega) z/breakaway)",
    parameters=(Parameter("breakaway_rad", lower=1e-4, upper=1.0),),
    source="Dahl, Aerospace Corp. TOR-0158(3107-18), 1968",
    reduced=lambda plant, q: {"breakaway_deg": math.degrees(q["breakaway_rad"])},
    structure=lambda plant, q: {"DEFLECTION": q["breakaway_rad"]},
)
