"""Every pulse loses a fixed time."""

from fiohost.motor.effect import Effect, Parameter


def command(duty_pct, period_s, q):  # type: ignore[no-untyped-def]
    lost = 1e-4 * q[0] / period_s if abs(duty_pct) < 100.0 else 0.0
    if duty_pct > lost:
        return duty_pct - lost
    if duty_pct < -lost:
        return duty_pct + lost
    return 0.0


EFFECTS = (
    Effect(
        name="pwm_dead_time",
        summary="every pulse loses a fixed time",
        equation="duty_eff = sgn(duty) * max(|duty| - 100 % * time * f, 0) at PWM frequency f; fully on has no pulses",
        acts_on="command",
        stage=35,
        commonness=7,
        signature="that of an input deadband, at 20 kHz of 2 % a microsecond",
        parameters=(Parameter("time_us", "us", 1.0, 0.0, 45.0),),
        trials=({"time_us": 0.5}, {"time_us": 2.0}),
        equivalents=("input_deadband",),
        source="Switching delays of the bridge; Mohan, Undeland, Robbins, Power Electronics",
        command=command,
    ),
)
