"""The gain drifts with time, whatever is done."""

from fiohost.motor.effect import Effect, Parameter


def current(i_pct, duty_pct, emf_pct, time_s, winding, q):  # type: ignore[no-untyped-def]
    return i_pct + duty_pct * q[0] * time_s * 1e-4


EFFECTS = (
    Effect(
        name="supply_drift",
        summary="gain drifts with time, whatever is done",
        equation="duty_eff = duty * (1 + pct_per_100_s / 100 * t / 100 s)",
        acts_on="current",
        stage=5,
        clocked=True,
        substep_s=0.005,
        signature="the same trend of gain in both directions and at rest",
        parameters=(Parameter("pct_per_100_s", "%", 2.0, -90.0, 90.0),),
        trials=({"pct_per_100_s": -3.0},),
        source="Discharge of a battery",
        current=current,
    ),
)
