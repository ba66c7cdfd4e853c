"""Inertia, friction, gain or supply changes during the run."""

from collections.abc import Mapping

from fiohost.motor.effect import Effect, Parameter, Span, Value

MOMENTS = 24
WHICH = ("inertia", "friction", "gain", "supply")
SUPPLY = WHICH.index("supply")


def current(i_pct, duty_pct, emf_pct, time_s, winding, q):  # type: ignore[no-untyped-def]
    """A supply's change scales what drives, not what the shaft gives back; the other changes are the kernel's own."""
    return i_pct + (duty_pct * (q[2] - 1.0) if q[1] == SUPPLY and time_s >= q[0] else 0.0)


def trials_for(span: Span) -> tuple[Mapping[str, Value], ...]:
    """Moments spread over the time of the data, for each thing that may change."""
    low, high = span.time_s
    times = [low + (high - low) * (i + 0.5) / MOMENTS for i in range(MOMENTS)]
    return tuple({"time_s": t, "which": w, "ratio": 1.15} for w in WHICH for t in times)


EFFECTS = (
    Effect(
        name="parameter_change",
        summary="inertia, friction, gain or supply changes during the run",
        equation="from time on, tau, friction, K or duty is multiplied by ratio",
        acts_on="structure",
        signature="one model before a moment, another after it",
        parameters=(
            Parameter("time_s", "s", 10.0, 0.0, 1e6, neutral=None, step=5e-3, ragged=True),
            Parameter("which", "", "inertia", neutral=None, choices=WHICH),
            Parameter("ratio", "", 1.3, 0.02, 50.0, neutral=1.0, step=1e-4),
        ),
        trials_for=trials_for,
        once=True,
        clocked=True,
        current=current,
        source="A load picked up or dropped; change detection, Basseville and Nikiforov 1993",
    ),
)
