"""The deadband by steps from rest: each duty a little larger, held for a while, until the shaft turns.

The way that a shaft turns within a step grows in a straight line with what the duty is above dry friction, so the first
two steps that turn it say where it began; never outside the last step that did not and the first that did, which is
where a shaft begins that sticks harder than it slides.
"""

from __future__ import annotations

import numpy as np

from fiohost.bench.deadband import Onset, does_not_start, turns_the_wrong_way
from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.bench.program import Hold
from fiohost.wire.messages import Command

STEP_PCT = 0.25
HOLD_S = 0.6
MOVED_COUNTS, STILL_COUNTS = 2.5, 1.5  # a shaft at the edge of a count flickers by one; between them it creeps
SECOND_PCT = 1.0  # how much more duty the second step has that turns the shaft


def step_until_it_starts(bench: Bench, forward: bool, begin_pct: float, max_pct: float) -> Onset:
    """Steps from rest upwards from ``begin_pct``. Raises DataError where the shaft does not start, or the wrong way."""
    sign = 1.0 if forward else -1.0
    logs: list[Log] = []

    def turned(level_pct: float) -> float:
        log = bench.play(Hold(Command.drive(sign * level_pct), round(HOLD_S / bench.sample_time_s)))
        logs.append(log)
        return float(sign * (log.output[-1] - log.output[0]))

    count_deg = 360.0 / bench.counts_per_rev
    least_deg = MOVED_COUNTS * count_deg
    level, below = max(begin_pct, STEP_PCT), 0.0
    while (way := turned(level)) < least_deg:
        if way <= -least_deg:
            raise turns_the_wrong_way(forward)
        if level >= max_pct:
            raise does_not_start(forward, max_pct)
        below = level if way < STILL_COUNTS * count_deg else below
        level = min(level + STEP_PCT, max_pct)
    tried = len(logs)
    start_pct = level
    if level + SECOND_PCT <= max_pct and (more := turned(level + SECOND_PCT)) > way:
        start_pct = level - way * SECOND_PCT / (more - way)
    if tried == 1:
        below = 0.0  # nothing smaller was tried
    return _onset(logs[:tried], sign * float(np.clip(start_pct, below, level)) + 0.0, forward)


def _onset(logs: list[Log], duty_pct: float, forward: bool) -> Onset:
    """All steps of one start behind each other, with the time at which the one that started the shaft began."""
    times, duties, moved = [], [], []
    now = start_s = 0.0
    for log in logs:
        start_s = now
        times.append(now + log.time_s)
        duties.append(log.duty_pct)
        moved.append(log.output - logs[0].output[0])
        now = float(times[-1][-1]) + log.sample_time_s
    return Onset(
        forward=forward,
        duty_pct=duty_pct,
        at_angle_deg=float(logs[-1].output[0]),  # an angle begins within its turn
        onset_s=start_s,
        time_s=np.concatenate(times),
        duty_acting_pct=np.concatenate(duties),
        moved_deg=np.concatenate(moved),
    )
