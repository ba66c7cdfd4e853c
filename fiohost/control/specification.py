"""What a position loop is asked for, what it does in simulation, and how far the one is from the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.control.closed_loop import Loop, LoopRun, Plant, run_loop
from fiohost.control.jitter import reversals
from fiohost.control.metrics import TAIL, step_figures
from fiohost.errors import ConfigError
from fiohost.motor.simulate import Start

MOST_REVERSALS_PER_S = 2.0  # of the duty once the response should rest: more is jitter or a limit cycle
RESTS = 0.5  # share of a run after which it should
NO_OVERSHOOT_PCT = 1e-9  # the last digits of a mean
OUT_OF_REACH = 20.0  # no ratio counts more than this


@dataclass(frozen=True)
class Specification:
    """Largest overshoot, settling time and steady-state error of a step.

    Settling is the last time outside ``band_pct`` of the step around the response's own final value, one count of the
    encoder at least. The error is the largest in the last tenth of the run, so that a loop that does not rest fails.
    """

    overshoot_pct: float = 5.0
    settling_s: float = 0.5
    sse_deg: float = 1.0
    band_pct: float = 2.0

    def __post_init__(self) -> None:
        ranges = {"overshoot_pct": 500.0, "settling_s": 60.0, "sse_deg": 360.0, "band_pct": 50.0}
        for name, most in ranges.items():
            if not 1e-3 <= getattr(self, name) <= most:
                raise ConfigError(f"{name} = {getattr(self, name):g} of a specification is outside 0.001..{most:g}")


@dataclass(frozen=True)
class StepOutcome:
    """The figures of one response: what is specified, and the rise time and jitter beside it."""

    step_deg: float
    overshoot_pct: float
    rise_s: float
    settling_s: float
    error_deg: float
    reversals_per_s: float

    def ratios(self, asked: Specification) -> tuple[float, float, float]:
        """Overshoot, settling and error as shares of what is allowed: 1 or less meets it."""
        return (
            self.overshoot_pct / asked.overshoot_pct,
            self.settling_s / asked.settling_s,
            self.error_deg / asked.sse_deg,
        )

    def meets(self, asked: Specification) -> bool:
        return max(self.ratios(asked)) < 1.0 and self.reversals_per_s <= MOST_REVERSALS_PER_S


def judge(
    time_s: np.ndarray, y_deg: np.ndarray, duty_pct: np.ndarray, start_deg: float, to_deg: float, band_pct: float,
    quantum_deg: float,
) -> StepOutcome:  # fmt: skip
    """The outcome of a response (n), times from the step. Raises DataError for fewer than two samples."""
    figures = step_figures(time_s, y_deg, start_deg, to_deg)
    step = to_deg - start_deg
    band = max(0.01 * band_pct * abs(step), quantum_deg)
    outside = np.flatnonzero(np.abs(y_deg - figures.final) > band + 1e-9)
    settling = float(time_s[min(outside[-1] + 1, len(time_s) - 1)]) if outside.size else 0.0
    rest = round(RESTS * len(y_deg))
    tail = max(1, round(TAIL * len(y_deg)))
    return StepOutcome(
        step_deg=step,
        overshoot_pct=figures.overshoot_pct if figures.overshoot_pct > NO_OVERSHOOT_PCT else 0.0,
        rise_s=figures.rise_s,
        settling_s=settling,
        error_deg=float(np.max(np.abs(to_deg - y_deg[-tail:]))),
        reversals_per_s=reversals(duty_pct[rest:]) / max(float(time_s[-1] - time_s[rest]), 1e-9),
    )


def simulate_step(plant: Plant, loop: Loop, step_deg: float, duration_s: float) -> LoopRun:
    """A step from rest in the middle of a count."""
    ticks = max(round(duration_s / loop.sample_time_s), 20) + 1
    start = Start(0.5 * loop.quantum_deg, 0.0)
    return run_loop(plant, loop, np.full(ticks, step_deg + (0.0 if loop.quantum_deg else start.angle)), start)


def outcomes(
    plants: Sequence[Plant], loop: Loop, steps_deg: Sequence[float], asked: Specification, duration_s: float
) -> list[StepOutcome]:
    """All steps on all plants, forward and in reverse."""
    found = []
    for plant in plants:
        for size in steps_deg:
            for step in (size, -size):
                run = simulate_step(plant, loop, step, duration_s)
                found.append(
                    judge(
                        run.time_s, run.angle_deg, run.duty_pct, float(run.angle_deg[0]), step, asked.band_pct,
                        loop.quantum_deg,
                    )
                )  # fmt: skip
    return found


def distance(found: Sequence[StepOutcome], asked: Specification) -> np.ndarray:
    """The worst ratio (3) of overshoot, settling and error; jitter counts as an error."""
    worst = np.array([one.ratios(asked) for one in found]).max(axis=0)
    jitter = max(one.reversals_per_s for one in found) / MOST_REVERSALS_PER_S
    worst[2] = max(worst[2], jitter)
    return np.asarray(np.minimum(worst, OUT_OF_REACH))
