"""The bridge opens between pulses: discontinuous conduction."""

from fiohost.motor.effect import Effect, Parameter


def lag(q):  # type: ignore[no-untyped-def]
    return q[0]


EFFECTS = (
    Effect(
        name="fast_decay",
        summary="bridge off, not shorted, between pulses (discontinuous conduction)",
        equation="mean current of a PWM period: on towards supply - emf, off towards -(supply + emf) until zero; where "
        "it never ceases it follows with electrical_tau_s",
        acts_on="current",
        substep_s=0.00125,
        commonness=4,
        signature="starts only near half duty, then steep",
        parameters=(Parameter("electrical_tau_s", "s", 0.001, 1e-5, 0.1, neutral=None, step=1e-3, relative_step=True),),
        trials=({"electrical_tau_s": 0.0003}, {"electrical_tau_s": 0.001}, {"electrical_tau_s": 0.004}),
        source="Erickson and Maksimovic, Fundamentals of Power Electronics, discontinuous conduction mode",
        opens=True,
        lag=lag,
    ),
)
