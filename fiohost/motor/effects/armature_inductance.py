"""The current lags its voltage."""

from fiohost.motor.effect import Effect, Parameter


def lag(q):  # type: ignore[no-untyped-def]
    return q[0]


EFFECTS = (
    Effect(
        name="armature_inductance",
        summary="electrical lag",
        equation="time_constant * di/dt = (duty - emf) - i; between the pulses the current ripples about i",
        acts_on="current",
        commonness=2,
        signature="position lags after every change of drive; grows with frequency, then less than a delay would",
        parameters=(Parameter("time_constant_s", "s", 0.002, 0.0, 0.1, step=2e-5),),
        trials=({"time_constant_s": 0.001}, {"time_constant_s": 0.003}, {"time_constant_s": 0.01}),
        source="INC451 lab 2, Eq. 2.2; L/R of the winding",
        lag=lag,
    ),
)
