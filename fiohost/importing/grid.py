"""The grid on which a sensor's values lie: its quantum, and the turn at which it wraps."""

from __future__ import annotations

import math

import numpy as np

from fiohost.importing.raw import FloatArray

MOST_VALUES = 20_000  # distinct values that are looked at
MOST_LEVELS = 200_000  # over the whole range: a finer grid is printing
OFF_GRID = 0.15  # of the quantum
FEW_LEVELS = 3
JUMP = 0.5  # of the range between two rows: a wrap, not a motion
TURNS = {"deg": 360.0, "rad": 2.0 * math.pi, "rev": 1.0}
TURN_MATCH = 0.05  # of a turn that a wrapping range may fall short of it
COUNTER_TURNS = (256, 32_768, 65_536, 2**31, 2**32)  # of counters of 8, 15, 16, 31 and 32 bits, which are no turns


def quantum_of(values: FloatArray) -> float:
    """The step of the grid on which nearly all values lie, 0 where there is none."""
    finite = values[np.isfinite(values)]
    distinct = np.unique(finite[: 50 * MOST_VALUES])
    if distinct.size < FEW_LEVELS:
        return float(np.ptp(distinct)) if distinct.size == 2 else 0.0
    span = float(distinct[-1] - distinct[0])
    if distinct.size > MOST_VALUES:
        distinct = distinct[np.linspace(0, distinct.size - 1, MOST_VALUES).astype(int)]
    steps = np.diff(distinct)
    steps = steps[steps > 1e-7 * span]
    if not steps.size:
        return 0.0
    least = float(steps.min())
    step = float(np.median(steps[steps < 1.5 * least]))
    near = distinct - distinct[0]
    size = min(near.size, 4)
    while True:  # the step is known the better the further it is counted
        counts = np.rint(near[:size] / step)
        step = float(np.dot(near[:size], counts) / np.dot(counts, counts)) if counts.any() else step
        if size >= near.size:
            break
        size = min(2 * size, near.size)
    counts = np.rint(near / step)
    off = np.abs(near / step - counts)
    if float(np.quantile(off, 0.99)) > OFF_GRID or span / step > MOST_LEVELS:
        return 0.0
    return float(f"{_rounded(step, span):.9g}")


def _rounded(step: float, span: float) -> float:
    """The step, or a number of few digits that is the same over the whole range."""
    for digits in range(1, 9):
        short = float(f"{step:.{digits}g}")
        if abs(short - step) / step * (span / step) < 1e-3:
            return short
    return step


def wrap_of(values: FloatArray, unit: str) -> float:
    """The size of a turn in the table's unit where the values wrap, 0 where they do not."""
    finite = values[np.isfinite(values)]
    if finite.size < 3:
        return 0.0
    low, high = float(finite.min()), float(finite.max())
    span = high - low
    jumps = np.abs(np.diff(finite))
    if span <= 0.0 or not np.any(jumps > JUMP * span):
        return 0.0
    wrapped = np.diff(finite)[jumps > JUMP * span]
    if np.count_nonzero(jumps > JUMP * span) > 0.2 * jumps.size:
        return 0.0  # noise or a signal of two levels, no turning
    turn = TURNS.get(unit)
    if turn is not None:
        fits = abs(span - turn) < TURN_MATCH * turn or bool(np.all(np.abs(wrapped) > 0.9 * turn))
        return turn if fits and span <= 1.001 * turn else 0.0
    if unit == "counts":
        for size in (*COUNTER_TURNS, 1024, 2048, 4096, 8192, 16_384):
            if size * (1.0 - TURN_MATCH) <= span + 1.0 <= size:
                return float(size)
        return _counts_of_turn(finite, span, low)
    return 0.0


def _counts_of_turn(counts: FloatArray, span: float, low: float) -> float:
    """The counts after which a counter begins anew: how far it jumps, and how far it moved meanwhile."""
    steps = np.diff(counts)
    at = np.flatnonzero(np.abs(steps) > JUMP * span)
    at = at[(at > 0) & (at < steps.size - 1)]
    least = span + 1.0 + (low if low < 0.05 * span else 0.0)
    if not at.size:
        return float(round(least))
    between = 0.5 * (steps[at - 1] + steps[at + 1])
    size = max(least, float(np.median(np.abs(steps[at] - between))))
    near = [n for n in range(int(max(least, 0.995 * size)), int(1.005 * size) + 2) if n >= least]
    smooth = [n for n in near if n % 100 == 0 or n % 360 == 0 or n in (512, 1024, 2048, 4096)]
    return float(min(smooth or [round(size)], key=lambda n: abs(n - size)))


def turn_of(values: FloatArray) -> str:
    """The unit of an angle that wraps, told by the size of its turn; "" where that tells nothing."""
    for unit in TURNS:
        if wrap_of(values, unit):
            return unit
    return ""
