"""General curves over the angle, of load and of friction: for what no sine fits."""

import math
from typing import Any

from fiohost.motor.effect import Effect, Kind, Parameter

# Points of the curve; the last one's value follows, as the curve has no mean: that is constant load or friction.
POINTS = 12
TRIAL_PCT = 0.2
FROM, SPAN, FIRST = 0, 1, 2
NAMES = tuple(f"point_{i}_pct" for i in range(1, POINTS))


def curve(theta_deg: float, q: Any) -> float:
    """A periodic cubic through the points, its slope at each that of the line through its neighbours."""
    at = (theta_deg - q[FROM]) / q[SPAN] * POINTS
    whole = math.floor(at)
    t = at - whole
    k = int(whole % POINTS)
    last = 0.0
    for i in range(POINTS - 1):
        last -= q[FIRST + i]
    a, b, c, d = (k - 1) % POINTS, k, (k + 1) % POINTS, (k + 2) % POINTS
    ya = last if a == POINTS - 1 else q[FIRST + a]
    yb = last if b == POINTS - 1 else q[FIRST + b]
    yc = last if c == POINTS - 1 else q[FIRST + c]
    yd = last if d == POINTS - 1 else q[FIRST + d]
    return float(yb + 0.5 * t * (yc - ya + t * (2.0 * ya - 5.0 * yb + 4.0 * yc - yd + t * (3.0 * (yb - yc) + yd - ya))))


def load(theta_deg, omega_deg_s, time_s, q):  # type: ignore[no-untyped-def]
    return -curve(theta_deg, q)


def friction(level, theta_deg, omega_deg_s, time_s, drive_pct, direction, z, q):  # type: ignore[no-untyped-def]
    return level + curve(theta_deg, q)


def parameters(limit_pct: float) -> tuple[Parameter, ...]:
    """Where the curve is laid, then its values at all points but the last."""
    return (
        Parameter("from_deg", "deg", 0.0, -1e6, 1e6, neutral=None, special=Kind.PLACE, order=-1),
        Parameter("span_deg", "deg", 360.0, 1e-2, 1e6, neutral=None, special=Kind.PLACE),
        *(Parameter(name, "%", 0.0, -limit_pct, limit_pct) for name in NAMES),
    )


SHAPE = (
    f"a periodic cubic of theta through {POINTS} points, spread evenly from from_deg over span_deg, whose values add "
    "up to zero"
)
SOURCE = "Catmull and Rom, A class of local interpolating splines, 1974; linear in the values of its points"

EFFECTS = (
    Effect(
        name="load_over_position",
        summary="a load that follows the angle by a curve of any shape",
        equation=f"load = {SHAPE}",
        acts_on="torque",
        substep_s=0.005,
        steps_a_lag=0.0,
        angle_bound=True,
        commonness=9,
        signature="missing torque over the angle, the same curve in both directions",
        parameters=parameters(90.0),
        trials=(dict.fromkeys(NAMES, TRIAL_PCT),),
        points=NAMES,
        source=SOURCE,
        load=load,
    ),
    Effect(
        name="friction_over_position",
        summary="friction that follows the angle by a curve of any shape",
        equation=f"friction = level + {SHAPE}; at least 0",
        acts_on="friction",
        stage=60,
        substep_s=0.005,
        steps_a_lag=0.0,
        angle_bound=True,
        commonness=9,
        signature="missing torque over the angle that changes sign with direction",
        parameters=parameters(90.0),
        trials=(dict.fromkeys(NAMES, TRIAL_PCT),),
        points=NAMES,
        source=SOURCE,
        friction=friction,
    ),
)
