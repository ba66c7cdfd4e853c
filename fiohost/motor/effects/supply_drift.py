"""The gain drifts with time, whatever is done."""

from fiohost.motor.effect import Effect, Parameter


def voltage(volts_pct, duty_pct, time_s, z, q):  # type: ignore[no-untyped-def]
    return volts_pct * max(1.0 + q[0] * time_s * 1e-4, 0.0)


EFFECTS = (
    Effect(
        name="supply_drift",
        summary="gain drifts with time, whatever is done",
        equation="duty_eff = duty * (1 + pct_per_100_s / 100 * t / 100 s)",
        acts_on="current",
        clocked=True,
        substep_s=0.005,
        steps_a_lag=0.0,
        signature="the same trend of gain in both directions and at rest",
        parameters=(Parameter("pct_per_100_s", "%", 2.0, -90.0, 90.0),),
        trials=({"pct_per_100_s": -3.0},),
        source="Discharge of a battery",
        voltage=voltage,
    ),
)
