"""The gain rises or falls as the motor warms."""

from fiohost.motor.effect import Effect, Parameter

RUNNING, TIME, HEAT = 0.0, 1.0, 2.0


def voltage(volts_pct, duty_pct, time_s, z, q):  # type: ignore[no-untyped-def]
    return volts_pct * (1.0 + q[0] * z)


def rate(z, omega_deg_s, current_pct, q):  # type: ignore[no-untyped-def]
    warming = 1.0
    if q[2] == RUNNING:
        warming = 1.0 if omega_deg_s != 0.0 else 0.0
    elif q[2] == HEAT:
        warming = (0.01 * current_pct) ** 2
    return warming / q[1], 1.0 / q[1]


EFFECTS = (
    Effect(
        name="gain_warm_up",
        summary="gain that rises or falls as it runs or warms",
        equation="voltage = duty * (1 + ratio * w); dw/dt = (warming - w) / time_constant; warming is 1 while it turns "
        "and 0 at rest (follows running), 1 throughout (time), or (current / stall)**2 (heat)",
        acts_on="current",
        stage=20,
        substep_s=0.005,
        steps_a_lag=4.0,
        commonness=7,
        warms=True,
        signature="gain, not friction, drifts to a new level and returns at rest",
        parameters=(
            Parameter("ratio", "", 0.02, -0.9, 5.0, step=1e-4),
            Parameter("time_constant_s", "s", 20.0, 0.5, 1000.0, neutral=None, step=1e-3, relative_step=True),
            Parameter("follows", "", "running", neutral=None, choices=("running", "time", "heat")),
        ),
        trials=tuple(
            {"ratio": 0.02, "time_constant_s": t, "follows": f}
            for f in ("running", "time", "heat")
            for t in (5.0, 20.0, 80.0)
        ),
        source="Magnets lose flux as they warm, 0.1 to 0.2 % per kelvin for ferrite: the speed rises; bridges settle",
        voltage=voltage,
        rate=rate,
    ),
)
