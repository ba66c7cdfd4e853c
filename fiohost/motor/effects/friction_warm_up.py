"""Friction that falls as the motor runs."""

from fiohost.motor.effect import Effect, Parameter


def friction(level, theta_deg, omega_deg_s, time_s, drive_pct, direction, z, q):  # type: ignore[no-untyped-def]
    return level * (1.0 - q[0] * z)


def rate(z, omega_deg_s, current_pct, q):  # type: ignore[no-untyped-def]
    return (1.0 / q[1] if omega_deg_s != 0.0 or q[2] == 1.0 else 0.0), 1.0 / q[1]


EFFECTS = (
    Effect(
        name="friction_warm_up",
        summary="friction falls as it runs",
        equation="friction = level * (1 - ratio * w); dw/dt = (warming - w) / time_constant; warming is 1 while it "
        "turns and 0 at rest (follows running), or 1 throughout (follows time)",
        acts_on="friction",
        stage=80,
        substep_s=0.005,
        steps_a_lag=0.0,
        commonness=6,
        warms=True,
        signature="friction, not gain, drifts down while the shaft turns",
        parameters=(
            Parameter("ratio", "", 0.3, 0.0, 0.95, step=1e-3),
            Parameter("time_constant_s", "s", 10.0, 0.5, 1000.0, neutral=None, step=1e-3, relative_step=True),
            Parameter("follows", "", "running", neutral=None, choices=("running", "time")),
        ),
        trials=tuple(
            {"ratio": 0.3, "time_constant_s": t, "follows": f} for f in ("running", "time") for t in (3.0, 10.0, 40.0)
        ),
        source="Bona and Indri, Friction compensation in robotics: an overview, CDC 2005",
        friction=friction,
        rate=rate,
    ),
)
