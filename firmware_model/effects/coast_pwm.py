"""A bridge that only switches on and off, slowly: between the pulses the motor coasts and its current runs down.

The winding needs an inductance, as the current's fall through the diodes is followed. Averaged over a period the mean
has a closed form where the current ceases in each; with edges resolved nothing is averaged.
"""

from firmware_model.effect import Effect, Parameter

EFFECT = Effect(
    name="coast_pwm",
    summary="bridge open between slow pulses",
    equation="as fast_decay, with a period of 1 / pwm_Hz: the current follows duty (V - Ke w) as it ceases at once",
    parameters=(Parameter("pwm_Hz", default=500.0, lower=20.0, upper=5000.0),),
    source="Toy and school controllers with a PWM of a few hundred hertz; Pybricks commit e3f342e95",
    reduced=lambda plant, q: {"decay_periods": plant.inductance_H / plant.R_ohm * q["pwm_Hz"]},
    structure=lambda plant, q: {"FAST": 1.0, "PERIOD": 1.0 / q["pwm_Hz"]},
)
