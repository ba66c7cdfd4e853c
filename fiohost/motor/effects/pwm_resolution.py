"""Duty in coarse steps."""

import math

from fiohost.motor.effect import Effect, Parameter


def command(duty_pct, period_s, q):  # type: ignore[no-untyped-def]
    steps = q[0] * 0.01
    if q[1] == 0.0:
        return math.floor(abs(duty_pct) * steps + 1e-9) / steps * (1.0 if duty_pct > 0.0 else -1.0)
    return math.floor(abs(duty_pct) * steps + 0.5 + 1e-9) / steps * (1.0 if duty_pct > 0.0 else -1.0)


EFFECTS = (
    Effect(
        name="pwm_resolution",
        summary="coarse duty steps",
        equation="duty_eff = duty cut, or rounded, to a multiple of 100 % / levels",
        acts_on="command",
        stage=10,
        commonness=5,
        signature="steps in the speed under a slow ramp; nothing at exact levels",
        parameters=(
            Parameter("levels", "", 100.0, 4.0, 2000.0, neutral=None, whole=True),
            Parameter("rounding", "", "cut", neutral=None, choices=("cut", "nearest")),
        ),
        trials=tuple(
            {"levels": float(n), "rounding": how}
            for n in (10, 16, 20, 25, 32, 40, 50, 64, 80, 100, 127, 128, 200, 255, 256)
            for how in ("cut", "nearest")
        ),
        source="Compare registers of few bits; Peterchev and Sanders, IEEE Trans. Power Electron. 18, 2003",
        command=command,
    ),
)
