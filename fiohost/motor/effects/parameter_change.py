"""Inertia, friction or gain changes during the run."""

from collections.abc import Mapping

from fiohost.motor.effect import Effect, Kind, Parameter, Span, Value

MOMENTS = 24
WHICH = ("inertia", "friction", "gain")
INERTIA, FRICTION, GAIN = range(3)
SAME_TIME_S = 1e-9


def inertia(ratio, time_s, q):  # type: ignore[no-untyped-def]
    return ratio * q[2] if q[1] == INERTIA and time_s >= q[0] - SAME_TIME_S else ratio


def friction(level, theta_deg, omega_deg_s, time_s, drive_pct, direction, z, q):  # type: ignore[no-untyped-def]
    return level * q[2] if q[1] == FRICTION and time_s >= q[0] - SAME_TIME_S else level


def voltage(volts_pct, duty_pct, time_s, z, q):  # type: ignore[no-untyped-def]
    """A gain's change scales what drives, not what the shaft gives back."""
    return volts_pct * q[2] if q[1] == GAIN and time_s >= q[0] - SAME_TIME_S else volts_pct


def moment(q):  # type: ignore[no-untyped-def]
    return q[0]


def trials_for(span: Span) -> tuple[Mapping[str, Value], ...]:
    """Moments spread over the time of the data, for each thing that may change."""
    low, high = span.time_s
    times = [low + (high - low) * (i + 0.5) / MOMENTS for i in range(MOMENTS)]
    return tuple({"time_s": t, "which": w, "ratio": 1.15} for w in WHICH for t in times)


EFFECTS = (
    Effect(
        name="parameter_change",
        summary="inertia, friction or gain changes during the run",
        equation="from time on, inertia, sliding friction or the voltage that drives is multiplied by ratio",
        acts_on="structure",
        signature="one model before a moment, another after it",
        parameters=(
            Parameter("time_s", "s", 10.0, 0.0, 1e6, neutral=None, step=5e-3, ragged=True, special=Kind.EVENT),
            Parameter("which", "", "inertia", neutral=None, choices=WHICH),
            Parameter("ratio", "", 1.3, 0.02, 50.0, neutral=1.0, step=1e-4),
        ),
        trials_for=trials_for,
        once=True,
        clocked=True,
        stage=90,
        inertia=inertia,
        friction=friction,
        voltage=voltage,
        moment=moment,
        source="A load picked up or dropped; change detection, Basseville and Nikiforov 1993",
    ),
)
