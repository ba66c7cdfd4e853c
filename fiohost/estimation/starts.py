"""Where records begin while a model is fitted to them: derivatives by what is free there, and steps along them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.estimation.initial import best_lash, find_zero, has_own_warmth, has_own_zero, initial_state
from fiohost.estimation.predict import Flat, errors, free_output
from fiohost.estimation.record import ANGLE, Record
from fiohost.estimation.settings import SETTINGS
from fiohost.estimation.tangent import Tangent
from fiohost.motor.simulate import Start
from fiohost.motor.state import GAIN


def start_columns(
    record: Record, flat: Flat, start: Start, residual: np.ndarray, windows: bool, tangent: Tangent | None
) -> np.ndarray:
    """Derivatives (n, 0..4) of what is simulated by the initial angle, speed, warmth and own zero, where these are
    free: ``windows``, along their ``tangent`` if there is one, leave but the last two, and a warmth at a bound that
    the ``residual`` (n) pulls against stays there.
    """
    columns: list[np.ndarray] = []

    def by(moved: Start, step: float) -> np.ndarray:
        if tangent is not None:
            return tangent.by(flat, moved, step)
        return np.asarray((residual - errors(record, flat, moved, windows)) / step)

    if record.kind == ANGLE and not windows:
        step = 1e-6 * 100.0 * abs(float(flat.p[GAIN]))
        columns.append(by(start._replace(angle=start.angle + step), step) if flat.bends else record.weights)
    if not record.at_rest and not windows:
        step = 1e-4 * 100.0 * abs(float(flat.p[GAIN])) + 1e-12
        columns.append(by(start._replace(speed=start.speed + step), step))
    if has_own_warmth(record, flat):
        step = SETTINGS.warmth_step if start.warmth < 0.5 else -SETTINGS.warmth_step
        warmth = by(start._replace(warmth=start.warmth + step), step)
        pull = float(warmth @ residual)
        if (start.warmth > 0.0 or pull > 0.0) and (start.warmth < 1.0 or pull < 0.0):
            columns.append(warmth)
    if has_own_zero(record, flat):
        columns.append(by(*_turned(flat, start, SETTINGS.zero_step_deg)))
    return np.column_stack(columns) if columns else np.empty((len(residual), 0))


def _turned(flat: Flat, start: Start, phase_deg: float) -> tuple[Start, float]:
    """A start whose zero is turned so that the fastest phase moves by so much, and by how much that is."""
    step = phase_deg / max(flat.orders())
    return start._replace(zero=(start.zero or 0.0) + step), step


def within_reach(
    record: Record, flat: Flat, start: Start, shift: np.ndarray, windows: bool, share: float
) -> np.ndarray:
    """A shift (n) of a start along the columns of its derivatives, that of warmth and own zero by a share of their
    reach at most; a warmth stays from 0 to 1.
    """
    found, last = shift.copy(), len(shift)
    if has_own_zero(record, flat):
        last, most = last - 1, share * SETTINGS.zero_step_at_most_deg / max(flat.orders())
        found[last] = min(max(found[last], -most), most)
    if last > _by_motion(record, windows):
        last, most = last - 1, share * SETTINGS.warmth_step_at_most
        found[last] = min(max(found[last], -most, -start.warmth), most, 1.0 - start.warmth)
    return found


def _by_motion(record: Record, windows: bool) -> int:
    """How many columns are those of angle and speed."""
    return 0 if windows else int(record.kind == ANGLE) + int(not record.at_rest)


def moved_start(record: Record, flat: Flat, start: Start, shift: np.ndarray, windows: bool) -> Start:
    """A start moved along the columns of its derivatives."""
    left = [float(s) for s in shift]
    if has_own_zero(record, flat):
        start = start._replace(zero=(start.zero or 0.0) + left.pop())
    if len(left) > _by_motion(record, windows):
        start = start._replace(warmth=start.warmth + left.pop())
    if record.kind == ANGLE and not windows:
        start = start._replace(angle=start.angle + left.pop(0))
    return start._replace(speed=start.speed + left.pop(0)) if left else start


def free_spans(record: Record, flat: Flat, columns: int) -> np.ndarray:
    """Standard deviations of what is free where windows begin (the last ``columns`` of ``start_columns``), were
    nothing known of it: uniform over all that it may be, a warmth from 0 to 1, a zero over the turn.
    """
    spans = [1.0] if has_own_warmth(record, flat) else []
    if has_own_zero(record, flat):
        spans.append(360.0 / max(flat.orders()))
    return np.asarray(np.array(spans[len(spans) - columns :]) / np.sqrt(12.0))


def first_starts(flat: Flat, records: Sequence[Record]) -> list[Start]:
    """How the records begin, each for itself."""
    return [initial_state(r, flat) for r in records]


def taken_up_play(flat: Flat, records: Sequence[Record], starts: Sequence[Start]) -> list[Start]:
    """The starts with the motor where in its gap suits the beginning of each record best, if the whole of it too."""
    if not flat.gap:
        return list(starts)
    found = []
    for record, was in zip(records, starts, strict=True):
        begins = min(len(record), round(SETTINGS.start.lash_shows_s / record.sample_time_s))

        def left(play: float, drift: float, n: int = begins, record: Record = record, was: Start = was) -> float:
            residual = record.y[:n] - free_output(record, flat, was._replace(play=play, drift=drift), n)
            weights = record.weights[:n] ** 2
            offset = float(weights @ residual / weights.sum()) if record.kind == ANGLE else 0.0
            return float(weights @ (residual - offset) ** 2)

        play, drift = best_lash(flat, left)
        pays = all(left(play, drift, n) < left(was.play, was.drift, n) * (1.0 - 1e-4) for n in (begins, len(record)))
        found.append(was._replace(play=play, drift=drift) if pays else was)
    return found


def with_origins(flat: Flat, records: Sequence[Record], starts: Sequence[Start], looking: bool = True) -> list[Start]:
    """The starts with every log's own zero, where it matters and is not known yet, or where one order left it open and
    ``looking`` says that others may not; cold where a warmth is not the log's own.
    """
    several, found = len(set(flat.orders())) > 1, []
    for record, start in zip(records, starts, strict=True):
        if has_own_zero(record, flat) and (start.zero is None or (looking and several)):
            start = start._replace(zero=find_zero(record, flat, near=start.zero, closely=start.zero is None))
        if flat.warms and not has_own_warmth(record, flat):
            start = start._replace(warmth=0.0)
        found.append(start)
    return found
