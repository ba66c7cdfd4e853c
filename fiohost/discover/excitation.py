"""What the logs excite, and which experiment would show what they do not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.identify.record import ANGLE, Record
from fiohost.motor.state import STANDBY

SPEED_SPAN_S = 0.05
# A shaft is at rest below the first share of its highest speed, slow below the second, at speed above the third.
REST, SLOW, AT_SPEED = 0.004, 0.15, 0.3
LEAST_REVERSALS, LEAST_STARTS = 3, 3
LEAST_SLOW_S, LEAST_COAST_S = 1.0, 0.5
FULL_DUTY_PCT = 70.0
FAST_HZ, FAST_SHARE = 2.0, 0.02
LONG_S = 120.0


@dataclass(frozen=True)
class Lack:
    """Something that the data say nothing about, in words, and the experiment that shows it.

    ``core`` lacks matter whatever the verdict; the others only where something is unexplained.
    """

    what: str
    experiment: str
    core: bool


def _speed(record: Record) -> np.ndarray:
    """Speed (n) in the record's unit a second, over a span longer than the counts' coarseness."""
    if record.kind != ANGLE:
        return record.y
    span = max(1, round(SPEED_SPAN_S / record.sample_time_s))
    padded = np.concatenate((np.full(span, record.y[0]), record.y))
    return np.asarray((padded[span:] - padded[:-span]) / (span * record.sample_time_s))


def _reversals(speeds: Sequence[np.ndarray], fast: float) -> int:
    """Changes of direction of a shaft that ran at speed before and after."""
    return sum(int(np.sum(np.diff(np.sign(v[np.abs(v) > fast])) != 0)) for v in speeds)


def _starts(speeds: Sequence[np.ndarray], rest: float, records: Sequence[Record]) -> int:
    """Starts from a rest of a tenth of a second."""
    count = 0
    for v, record in zip(speeds, records, strict=True):
        still = np.abs(v) <= rest
        edges = np.flatnonzero(np.diff(still.astype(int), prepend=0, append=0))
        least = 0.1 / record.sample_time_s
        count += sum(1 for a, b in zip(edges[::2], edges[1::2], strict=True) if b < len(v) and b - a >= least)
    return count


def _seconds(masks: Sequence[np.ndarray], records: Sequence[Record]) -> float:
    return float(sum(m.sum() * r.sample_time_s for m, r in zip(masks, records, strict=True)))


def _fast_share(records: Sequence[Record]) -> float:
    """Share of the commands' power about their mean that lies above ``FAST_HZ``."""
    fast = total = 0.0
    for record in records:
        duty = record.excitation.duties_pct[1:]
        power = np.abs(np.fft.rfft(duty - duty.mean())) ** 2
        fast += float(power[np.fft.rfftfreq(len(duty), record.sample_time_s) > FAST_HZ].sum())
        total += float(power.sum())
    return fast / total if total > 0 else 0.0


def lacks(records: Sequence[Record]) -> list[Lack]:
    """What the records do not excite, the most telling first."""
    speeds = [_speed(r) for r in records]
    top = max((float(np.max(np.abs(v))) for v in speeds), default=0.0)
    if top <= 0.0:
        return []
    coarse = max((r.quantum / SPEED_SPAN_S for r in records if r.kind == ANGLE), default=0.0)
    rest, slow, fast = max(REST * top, 0.5 * coarse), SLOW * top, AT_SPEED * top
    both = min(max(float(np.max(s * v)) for v in speeds) for s in (1.0, -1.0)) > fast
    drifting = [(np.abs(v) > rest) & (np.abs(v) < slow) for v in speeds]
    coasting = [(r.excitation.modes[1:] == STANDBY) & (np.abs(v) > rest) for r, v in zip(records, speeds, strict=True)]
    duty = max(float(np.max(np.abs(r.excitation.duties_pct))) for r in records)
    clock = [r.excitation.clock_s for r in records]
    length = max(c + r.seconds for c, r in zip(clock, records, strict=True)) - min(clock)
    checks: list[tuple[Callable[[], bool], str, str, bool]] = [
        (lambda: not both, "motion in both directions", "staircase", True),
        (lambda: _reversals(speeds, fast) < LEAST_REVERSALS, "reversals at speed", "reversals", True),
        (lambda: _seconds(drifting, records) < LEAST_SLOW_S, "slow motion", "triangle_slow", True),
        (lambda: _starts(speeds, rest, records) < LEAST_STARTS, "starts from rest", "starts_slow", True),
        (lambda: duty < FULL_DUTY_PCT, "high duty", "ramp_full", True),
        (lambda: _fast_share(records) < FAST_SHARE, f"commands faster than {FAST_HZ:g} Hz", "multisine_fast", False),
        (lambda: _seconds(coasting, records) < LEAST_COAST_S, "run-down in standby", "coast", False),
        (lambda: length < LONG_S, "two minutes of run", "soak", False),
    ]
    return [Lack(what, experiment, core) for lacking, what, experiment, core in checks if lacking()]
