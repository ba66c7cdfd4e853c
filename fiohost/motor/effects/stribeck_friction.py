"""Friction that is higher at low speed, and break-away above sliding friction."""

import math

from fiohost.motor.effect import Effect, Parameter


def friction(level, theta_deg, omega_deg_s, time_s, drive_pct, direction, z, q):  # type: ignore[no-untyped-def]
    ratio = abs(omega_deg_s) / q[1]
    return level + q[0] * math.exp(-ratio if q[2] == 0.0 else -ratio * ratio)


def breakaway(q):  # type: ignore[no-untyped-def]
    return q[0]


EFFECTS = (
    Effect(
        name="stribeck_friction",
        summary="friction higher at low speed",
        equation="friction = level + extra * exp(-(|omega| / stribeck_speed)**n), n = 1 exponential, 2 gaussian",
        acts_on="friction",
        stage=10,
        substep_s=0.0025,
        steps_a_lag=8.0,
        signature="missing torque that falls as the speed rises; stick-slip at slow speeds",
        parameters=(
            Parameter("extra_pct", "%", 2.0, 0.0, 50.0),
            Parameter(
                "stribeck_speed_deg_s",
                "deg/s",
                60.0,
                0.01,
                1e5,
                neutral=None,
                step=1e-3,
                relative_step=True,
                by_speed=1.0,
            ),
            Parameter("shape", "", "exponential", neutral=None, choices=("exponential", "gaussian")),
        ),
        trials=tuple(
            {"extra_pct": 1.5, "stribeck_speed_deg_s": v, "shape": s}
            for v in (15.0, 60.0, 200.0)
            for s in ("exponential", "gaussian")
        ),
        source="R. Stribeck 1902; Tustin 1947 (exponential); Armstrong-Helouvry 1991 (gaussian)",
        friction=friction,
    ),
    Effect(
        name="static_friction",
        summary="break-away above sliding friction",
        equation="at rest friction holds up to level + extra, moving it is level",
        acts_on="friction",
        commonness=3,
        signature="late starts from rest only; nothing while moving",
        parameters=(Parameter("extra_pct", "%", 1.5, 0.0, 50.0, step=0.02, ragged=True),),
        trials=({"extra_pct": 0.5}, {"extra_pct": 1.5}, {"extra_pct": 4.0}),
        source="D. Karnopp, Computer simulation of stick-slip friction, ASME J. Dyn. Syst. 107, 1985",
        breakaway=breakaway,
    ),
)
