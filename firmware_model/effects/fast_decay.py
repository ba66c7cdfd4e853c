"""The bridge is open, not shorted, between the pulses: the current runs down through the diodes against the supply.

Averaged over a PWM period. While the current never ceases the mean voltage is (2 duty - 1) supply; where it ceases
within a period its mean follows from that period alone, in closed form, with the winding's exponentials.
"""

from firmware_model.effect import Effect, Parameter

EFFECT = Effect(
    name="fast_decay",
    summary="bridge open between the pulses, discontinuous conduction",
    equation="v = (2d - 1) V while current flows; where it ceases, a pulse up (V - Ke w) and down (V + Ke w)",
    parameters=(Parameter("diode_V", default=0.0, lower=0.0),),
    source="Pybricks commit e3f342e95; Erickson and Maksimovic, Fundamentals of Power Electronics, ch. 5",
    reduced=lambda plant, q: {"electrical_tau_s": plant.inductance_H / plant.R_ohm},
    structure=lambda plant, q: {"FAST": 1.0, "DIODE": q["diode_V"]},
)
