"""Torque or gain that swings at a fixed frequency, whatever the shaft does."""

import math
from collections.abc import Mapping
from typing import Any

from fiohost.motor.effect import Effect, Parameter, Span, Value

TORQUE, GAIN = 0.0, 1.0


def swing(time_s: float, q: Any) -> float:
    return float(q[0] * math.sin(2.0 * math.pi * q[1] * time_s + q[2] * (math.pi / 180.0)))


def torque(theta_deg, omega_deg_s, time_s, q):  # type: ignore[no-untyped-def]
    return swing(time_s, q) if q[3] == TORQUE else 0.0


def voltage(volts_pct, duty_pct, time_s, z, q):  # type: ignore[no-untyped-def]
    return volts_pct * (1.0 + 0.01 * swing(time_s, q)) if q[3] == GAIN else volts_pct


def trials(span: Span) -> tuple[Mapping[str, Value], ...]:
    """One for each line in what is left, of a torque and of a gain."""
    return tuple({"level_pct": 1.0, "frequency_hz": f, "of": of} for f in span.lines_hz for of in ("torque", "gain"))


EFFECTS = (
    Effect(
        name="clock_ripple",
        summary="torque or gain that swings at a fixed frequency",
        equation="torque = level * sin(360 deg * frequency * t + phase), or voltage * (1 + level / 100 % * the same)",
        acts_on="torque",
        stage=5,
        clocked=True,
        drives=True,
        substep_s=0.002,
        steps_a_lag=0.0,
        commonness=7,
        signature="a line in the spectrum over time that stays where it is at any speed",
        parameters=(
            Parameter("level_pct", "%", 1.0, 0.0, 90.0, step=1e-3),
            Parameter("frequency_hz", "Hz", 1.0, 0.01, 100.0, neutral=None, step=1e-5, relative_step=True),
            Parameter("phase_deg", "deg", 0.0, -1e4, 1e4, neutral=None, period=360.0),
            Parameter("of", "", "torque", neutral=None, choices=("torque", "gain")),
        ),
        trials_for=trials,
        couples=(("level_pct", "phase_deg"),),
        source="Ripple of a supply, a program's slow task, vibration of the bench",
        torque=torque,
        voltage=voltage,
    ),
)
