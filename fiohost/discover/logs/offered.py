"""Which effects may be added to a model of some records, and what these cover."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.discover.settings import SETTINGS
from fiohost.estimation.record import ANGLE, Record
from fiohost.motor.effect import Effect, Span, effects
from fiohost.motor.model import Model

SCREEN = SETTINGS.screen


def candidates(model: Model, records: Sequence[Record], library: Sequence[str] | None, span: Span) -> list[Effect]:
    """Effects that may be added to a model: those of the library that are not in it and can act on such records, which
    cover a ``span``.
    """
    names = effects() if library is None else library
    rotary, angles = all(r.rotary for r in records), all(r.kind == ANGLE for r in records)
    chosen = [effects()[n] for n in names if n != "linear" and n not in model.effects]
    trying = [e for e in chosen if e.tried(span) and (e.measure_speed is None or any(r.kind != ANGLE for r in records))]
    # Speeds add up to where on its turn a shaft is, not to what an angle's sensor says there.
    return [e for e in trying if not e.angle_bound or (rotary and (angles or e.measure is None))]


def span_of(records: Sequence[Record]) -> Span:
    """What the records cover."""
    begin = min(r.excitation.clock_s for r in records)
    end = max(r.excitation.clock_s + r.seconds for r in records)
    ends = [end for r in records if r.kind == ANGLE for end in _ends(r)]
    return Span((begin, end), tuple(ends), full_deg_s=max(_full_speed(r) for r in records))


def _full_speed(record: Record) -> float:
    """The speed that a record reached, but for its fastest moments: of an angle, its mean over some samples."""
    if record.kind != ANGLE:
        speeds = record.y
    else:
        times, some = record.excitation.times_s, max(1, round(SCREEN.resolution_s / record.sample_time_s))
        speeds = (record.y[some:] - record.y[:-some]) / (times[some:] - times[:-some])
    return float(np.quantile(np.abs(speeds), SCREEN.reached)) if len(speeds) else 0.0


def _ends(record: Record) -> list[float]:
    """Where a record's shaft stood at its extreme angle though driven on, or came to stand there at once from speed; a
    count's middle.
    """
    found = []
    duty = record.acting_pct
    for side in (1.0, -1.0):
        outward = side * record.smooth
        there = outward >= outward.max() - (1.01 * record.quantum + SCREEN.near_scatter * record.scatter)
        held = np.count_nonzero(there & (side * duty > SCREEN.driven_on_pct)) * record.sample_time_s >= SCREEN.held_s
        first = int(np.argmax(there))
        came = outward[first - 1] - outward[first - 3] >= SCREEN.abrupt_counts * record.quantum if first >= 3 else False
        if held or (came and there[first : first + SCREEN.stands].all()):
            found.append(side * float(np.median(outward[there])) + 0.5 * record.quantum)
    return found
