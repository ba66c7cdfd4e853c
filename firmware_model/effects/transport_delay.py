"""Every command acts later than it was latched."""

from firmware_model.effect import Effect, Parameter

# The kernel keeps this many commands on their way: at 5 ms a step, 1.2 s.
LONGEST_S = 1.2

EFFECT = Effect(
    name="transport_delay",
    summary="dead time between a command's latching and its action; brake and standby wait as well",
    equation="duty_eff(t) = duty(t - delay)",
    parameters=(Parameter("delay_s", lower=0.0, upper=LONGEST_S),),
    source="Report latency; Franklin, Powell, Workman, Digital Control of Dynamic Systems",
    reduced=lambda plant, q: {"delay_s": q["delay_s"]},
    structure=lambda plant, q: {"DELAY": q["delay_s"]},
)
