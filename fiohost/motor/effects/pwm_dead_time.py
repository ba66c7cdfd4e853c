"""Every pulse loses a fixed time."""

from fiohost.motor.effect import Effect, Parameter


def command(duty_pct, q):  # type: ignore[no-untyped-def]
    lost = 2.0 * q[0] if abs(duty_pct) < 100.0 else 0.0
    if duty_pct > lost:
        return duty_pct - lost
    if duty_pct < -lost:
        return duty_pct + lost
    return 0.0


EFFECTS = (
    Effect(
        name="pwm_dead_time",
        summary="every pulse loses a fixed time",
        equation="duty_eff = sgn(duty) * max(|duty| - time / 50 us, 0) at 20 kHz; a bridge fully on has no pulses",
        acts_on="command",
        stage=31,
        commonness=7,
        signature="that of an input deadband of 2 % a microsecond",
        parameters=(Parameter("time_us", "us", 1.0, 0.0, 45.0),),
        trials=({"time_us": 0.5}, {"time_us": 2.0}),
        equivalents=("input_deadband",),
        source="Switching delays of the bridge; Mohan, Undeland, Robbins, Power Electronics",
        command=command,
    ),
)
