"""What records went through, for those who use a model beyond it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.estimation.record import ANGLE, Record
from fiohost.motor.seen import Seen, together
from fiohost.motor.state import STANDBY

SPEED_OVER_S = 0.1


def seen_of(records: Sequence[Record]) -> Seen:
    """Ranges of all records together; at least one."""
    return together([_seen(r) for r in records])


def _seen(record: Record) -> Seen:
    ex, span = record.excitation, max(1, round(SPEED_OVER_S / record.sample_time_s))
    times = ex.times_s
    if record.kind == ANGLE:
        n = min(span, len(record) - 1)
        speed = (record.y[n:] - record.y[:-n]) / (times[n:] - times[:-n])
    else:
        speed = np.convolve(record.y, np.ones(span) / span, mode="valid")
    duty, modes = ex.duties_pct[1:], ex.modes[1:]
    changes = np.flatnonzero((np.diff(duty) != 0.0) | (np.diff(modes) != 0)) + 1
    edges = np.concatenate(([0], changes, [len(duty) - 1]))
    holds = np.diff(times[np.minimum(edges, len(times) - 1)])
    return Seen(
        (float(duty.min()), float(duty.max())),
        (float(speed.min()), float(speed.max())),
        float(holds.max(initial=0.0)),
        bool((modes == STANDBY).any()),
    )
