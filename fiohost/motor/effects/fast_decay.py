"""The bridge opens between pulses: discontinuous conduction."""

import math

from fiohost.motor.compiled import inlined
from fiohost.motor.effect import Effect, Parameter

PERIOD_S = 50e-6


@inlined
def fall_time(on, e, tau):  # type: ignore[no-untyped-def]
    """Time until the current of a pulse of length ``on`` is zero again, all times in PWM periods."""
    return tau * math.log1p((1.0 - e) * -math.expm1(-on / tau) / (1.0 + e))


def current(i_pct, duty_pct, emf_pct, time_s, winding, q):  # type: ignore[no-untyped-def]
    """Mean current over a 50 us period: it rises towards 1 - e while on, falls towards -(1 + e) until it is zero."""
    if duty_pct == 0.0:
        return i_pct
    sign = 1.0 if duty_pct > 0.0 else -1.0
    on = min(abs(duty_pct) * 0.01, 1.0)
    e = min(max(emf_pct * 0.01 * sign, -0.99), 0.99)
    if on >= 1.0:
        return i_pct
    fall = fall_time(on, e, q[0] / PERIOD_S)
    if on + fall < 1.0:
        return 100.0 * sign * ((1.0 - e) * on - (1.0 + e) * fall)
    return 100.0 * sign * (2.0 * on - 1.0 - e)


EFFECTS = (
    Effect(
        name="fast_decay",
        summary="bridge off, not shorted, between pulses (discontinuous conduction)",
        equation="mean current of a PWM period: on towards supply - emf, off towards -(supply + emf) until zero; where "
        "it never ceases it follows with electrical_tau_s",
        acts_on="current",
        stage=10,
        substep_s=0.00125,
        commonness=4,
        signature="starts only near half duty, then steep",
        parameters=(Parameter("electrical_tau_s", "s", 0.001, 5e-5, 0.1, neutral=None, step=1e-3, relative_step=True),),
        trials=({"electrical_tau_s": 0.0003}, {"electrical_tau_s": 0.001}, {"electrical_tau_s": 0.004}),
        source="Erickson and Maksimovic, Fundamentals of Power Electronics, discontinuous conduction mode",
        current=current,
    ),
)
