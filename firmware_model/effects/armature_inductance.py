"""The winding's inductance, for a plant that has none of its own."""

from firmware_model.effect import Effect, Parameter

EFFECT = Effect(
    name="armature_inductance",
    summary="electrical lag of the winding",
    equation="L di/dt = v - Ke omega - R i",
    parameters=(Parameter("inductance_H", lower=0.0, upper=10.0),),
    source="Control lab appendix, section D-1-3",
    reduced=lambda plant, q: {"time_constant_s": q["inductance_H"] / plant.R_ohm},
    structure=lambda plant, q: {"L": q["inductance_H"]},
)
