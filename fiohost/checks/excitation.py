"""Which experiment would show what the logs did not go through."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fiohost.checks.exercised import Exercised
from fiohost.checks.informative import (
    FEW_LEVELS,
    FEW_REVERSALS,
    FEW_STARTS,
    LEAST_BRAKING_S,
    LEAST_SLOW_S,
    LOW_BAND_HZ,
    SLOW_S,
)

# What saturates does so near full duty first.
HIGH_DUTY_PCT = 90.0


@dataclass(frozen=True)
class Lack:
    """Something that the data say little or nothing about, in words, and the experiment that shows it.

    ``core`` lacks matter whatever the verdict; the others only where something is unexplained.
    """

    what: str
    experiment: str
    core: bool


CHECKS: Sequence[tuple[Callable[[Exercised], bool], Lack]] = (
    (lambda d: not d.both_directions, Lack("motion in both directions", "staircase", True)),
    (lambda d: d.reversals < FEW_REVERSALS, Lack("reversals", "reversals", True)),
    (lambda d: d.slow_s < LEAST_SLOW_S, Lack("slow motion", "triangle_slow", True)),
    (lambda d: d.starts < FEW_STARTS, Lack("starts from rest", "starts_slow", True)),
    (lambda d: d.levels < FEW_LEVELS, Lack("different levels of duty", "staircase", True)),
    (lambda d: d.closed_loop_only, Lack("run in open loop", "multisine", False)),
    (lambda d: d.braking_s < LEAST_BRAKING_S, Lack("turning against the command", "reversals", False)),
    (lambda d: d.useful_hz is not None and d.useful_hz < LOW_BAND_HZ, Lack("fast motion", "multisine_fast", False)),
    (lambda d: d.duty_max_pct < HIGH_DUTY_PCT, Lack("high duty", "ramp_full", False)),
    (lambda d: d.seconds < SLOW_S, Lack("time for slow changes", "soak", False)),
)


def lacks(seen: Exercised) -> list[Lack]:
    """What logs that went through this do not show, the most telling first."""
    return [lack for lacking, lack in CHECKS if lacking(seen)]
