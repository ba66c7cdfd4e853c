"""A part of the duty comes in steps."""

import math

from fiohost.motor.effect import Effect, Parameter

CUT, NEAREST = 0.0, 1.0
TIE = 1e-9  # a duty that is a step but for its last digit


def command(duty_pct, period_s, q):  # type: ignore[no-untyped-def]
    size = abs(duty_pct)
    steps = size / q[0]
    if q[2] == CUT:
        steps = math.floor(steps + TIE)
    elif q[2] == NEAREST:
        steps = math.floor(steps + 0.5 + TIE)
    else:
        steps = math.ceil(steps - TIE)
    size = min(max(size + q[1] * (steps * q[0] - size), 0.0), 100.0)
    return size if duty_pct > 0.0 else -size


EFFECTS = (
    Effect(
        name="duty_steps",
        summary="a part of the duty comes in steps",
        equation="duty_eff = duty + share * (step * n - duty), n = |duty| / step cut, rounded, or up to a whole "
        "number; at most 100 %",
        acts_on="command",
        stage=12,
        commonness=7,
        signature="the speed jumps a little at every step of the duty, and rises in proportion between",
        parameters=(
            Parameter("step_pct", "%", 10.0, 0.2, 60.0, neutral=None, step=1e-2, ragged=True),
            Parameter("share", "", 0.2, -0.9, 0.9, step=1e-4),
            Parameter("rounding", "", "cut", neutral=None, choices=("cut", "nearest", "up")),
        ),
        trials=tuple(
            {"step_pct": step, "share": 0.2, "rounding": how}
            for step in (5.0, 10.0, 12.5, 20.0, 25.0, 50.0)
            for how in ("cut", "nearest")
        ),
        source="Whole-number arithmetic of a controller; Peterchev and Sanders, IEEE Trans. Power Electron. 18, 2003",
        command=command,
    ),
)
