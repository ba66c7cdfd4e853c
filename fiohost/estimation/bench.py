"""The records of one bench: what they share, and on which of its turns each begins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from fiohost.errors import DataError
from fiohost.estimation.record import Record
from fiohost.estimation.settings import SETTINGS


def pwm_of(records: Sequence[Record]) -> float:
    """The PWM's frequency in Hz that the records share, 0 where none says one. Raises DataError where they differ."""
    said = sorted({r.pwm_hz for r in records if r.pwm_hz > 0.0})
    if len(said) > 1:
        raise DataError(f"the logs are of benches whose PWM differs ({said[0]:g} and {said[-1]:g} Hz); take them apart")
    return said[0] if said else 0.0


def with_bench(records: Sequence[Record]) -> list[Record]:
    """The records of one bench: its time and its turns begin with the earliest of them, and the first defines its zero
    where all have zeros of their own.
    """
    if not records:
        return []
    earliest = min(range(len(records)), key=lambda i: records[i].excitation.clock_s)
    found = [replace(r, begins=i == earliest) for i, r in enumerate(on_turns(records))]
    if all(r.own_zero for r in found):
        found[0] = replace(found[0], own_zero=False)
    shown = next((r.average for r in found if r.average), None)
    average = shown if shown and all(shown.holds(r.y) for r in found) else None
    return [replace(r, average=average) for r in found]


def joining(records: Sequence[Record], bench: Sequence[Record]) -> list[Record]:
    """Further records of a ``bench``: on its turns, by its logger's average."""
    return [replace(r, average=bench[0].average) for r in on_turns(records, bench)]


def overlapping(records: Sequence[Record]) -> bool:
    """Whether two records share half of the shorter one's time on their bench: they do not say when they were begun."""
    spans = sorted((r.excitation.clock_s, r.excitation.clock_s + r.seconds) for r in records)
    return any(end - begin > 0.5 * min(end - start, until - begin) for (start, end), (begin, until) in pairwise(spans))


def on_turns(records: Sequence[Record], before: Sequence[Record] = ()) -> list[Record]:
    """Records of a counter that says no whole turns, each on the turn on which the one earlier left the shaft, of these
    or of those ``before``: an end of travel is then where it was.

    Between two the shaft is braked and goes from where it was left by no more than its last speed leads. Where that is
    a turn or more, or records do not say when they were begun, they stay as they are.
    """
    if overlapping([*before, *records]) or not all(r.wraps for r in (*before, *records)):
        return list(records)
    found, placed = list(records), sorted(before, key=lambda r: r.excitation.clock_s)
    for i in sorted(range(len(records)), key=lambda i: records[i].excitation.clock_s):
        record = records[i]
        earlier = [r for r in placed if r.excitation.clock_s < record.excitation.clock_s]
        if earlier:
            last = max(earlier, key=lambda r: r.excitation.clock_s)
            found[i] = on_turn(record, _turns(last, record))
        placed.append(found[i])
    return found


def on_turn(record: Record, turns: int) -> Record:
    """A record by so many turns ahead."""
    return replace(record, y=record.y + 360.0 * turns, ahead_deg=record.ahead_deg + 360.0 * turns)


def _turns(last: Record, record: Record) -> int:
    """How many turns the shaft was on when a record began, after the ``last``."""
    times = last.excitation.times_s[-SETTINGS.start.last_samples :]
    speed = float(last.y[-1] - last.y[-len(times)]) / float(times[-1] - times[0])
    goes = speed * (record.excitation.clock_s - last.excitation.clock_s - last.seconds)
    # Slowed evenly it goes half as far.
    return round((float(last.y[-1]) + 0.5 * goes - float(record.y[0])) / 360.0) if abs(goes) < 360.0 else 0
