"""Errors of the sensor: eccentric disc, errors locked to the shaft, lost counts, a speed without its sign."""

import math

from fiohost.motor.effect import Effect, Parameter

ORDERS = 3


def eccentricity(theta_deg, q):  # type: ignore[no-untyped-def]
    return theta_deg + q[0] * math.sin((q[1] * theta_deg + q[2]) * (math.pi / 180.0))


def harmonics(theta_deg, q):  # type: ignore[no-untyped-def]
    shown = theta_deg
    for order in range(1, ORDERS + 1):
        shown += q[2 * order - 2] * math.sin((order * theta_deg + q[2 * order - 1]) * (math.pi / 180.0))
    return shown


def unsigned(omega_deg_s, z, q):  # type: ignore[no-untyped-def]
    return omega_deg_s + q[0] * (abs(omega_deg_s) - omega_deg_s)


def missed(theta_deg, q):  # type: ignore[no-untyped-def]
    return theta_deg * (1.0 - q[0])


EFFECTS = (
    Effect(
        name="encoder_eccentricity",
        summary="measuring error N times a turn",
        equation="reading = theta + level * sin(order * theta + phase)",
        acts_on="measurement",
        stage=10,
        angle_bound=True,
        commonness=6,
        signature="ripple of constant size in position at any speed",
        parameters=(
            Parameter("level_deg", "deg", 1.0, 0.0, 20.0, step=1e-3),
            Parameter("order", "per turn", 1.0, 1.0, 64.0, neutral=None, whole=True),
            Parameter("phase_deg", "deg", 0.0, -1e4, 1e4, neutral=None, period=360.0),
        ),
        trials=tuple({"level_deg": 0.5, "order": float(n)} for n in (1, 2, 3, 4, 5, 6, 8, 10, 12, 15, 16, 20)),
        couples=(("level_deg", "phase_deg"),),
        source="Ellin and Dolsak, The design and application of rotary encoders, Sensor Review 28, 2008",
        measure=eccentricity,
    ),
    Effect(
        name="shaft_angle_error",
        summary="measuring error locked to the shaft, orders 1 to 3",
        equation="reading = theta + sum over n = 1, 2, 3 of level_n * sin(n * theta + phase_n)",
        acts_on="measurement",
        stage=10,
        angle_bound=True,
        commonness=7,
        signature="ripple of constant size in position at any speed, once to three times a turn",
        # A log whose angle begins anew has phases of its own: all move with its zero, each by its order. Where sensor
        # and shaft slip from run to run, the phases are what differs by run and the levels what is common.
        parameters=tuple(
            parameter
            for n in range(1, ORDERS + 1)
            for parameter in (
                Parameter(f"level_{n}_deg", "deg", 0.2, 0.0, 20.0, step=1e-3),
                Parameter(f"phase_{n}_deg", "deg", 0.0, -1e4, 1e4, neutral=None, period=360.0, order=n),
            )
        ),
        trials=({f"level_{n}_deg": 0.2 for n in range(1, ORDERS + 1)},),
        couples=tuple((f"level_{n}_deg", f"phase_{n}_deg") for n in range(1, ORDERS + 1)),
        source="Ellin and Dolsak, The design and application of rotary encoders, Sensor Review 28, 2008",
        measure=harmonics,
    ),
    Effect(
        name="unsigned_speed",
        summary="a sensor of speed that does not know the direction",
        equation="reading = omega + share * (|omega| - omega); a share of 1 shows the size of the speed alone",
        acts_on="measurement",
        commonness=6,
        signature="speeds that never fall below zero though the command drives both ways; nothing in angles",
        parameters=(Parameter("share", "", 1.0, 0.0, 1.0, step=1e-4),),
        trials=({"share": 1.0},),
        source="Tachometers of one channel, rectified generators",
        measure_speed=unsigned,
    ),
    Effect(
        name="missed_counts",
        summary="share of counts lost",
        equation="reading = (1 - ratio) * theta; equals a lower gain unless something is bound to the true angle",
        acts_on="measurement",
        stage=20,
        commonness=8,
        signature="none of its own: angles that do not close over an out-and-back run to a mark",
        parameters=(Parameter("ratio", "", 0.02, 0.0, 0.9, step=1e-4),),
        equivalents=("linear",),
        source="Slow input filters and interrupts that lose edges",
        measure=missed,
    ),
)
