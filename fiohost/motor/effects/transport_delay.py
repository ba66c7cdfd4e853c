"""Dead time between the command and its action, beyond what the bench's timing explains."""

from fiohost.motor.effect import Effect, Parameter


def delay(q):  # type: ignore[no-untyped-def]
    return q[0]


EFFECTS = (
    Effect(
        name="transport_delay",
        summary="dead time beyond command_delay_ticks",
        equation="duty_eff(t) = duty(t - delay)",
        acts_on="timing",
        commonness=3,
        signature="position lags by delay * speed at every acceleration; grows in proportion to frequency",
        parameters=(Parameter("delay_s", "s", 0.005, 0.0, 0.5, step=1e-5),),
        trials=tuple({"delay_s": delay} for delay in (0.0025, 0.005, 0.01, 0.02, 0.04)),
        source="Report latency and computation time; Franklin, Powell, Workman, Digital Control of Dynamic Systems",
        delay=delay,
    ),
)
