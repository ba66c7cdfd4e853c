"""How many counts make a turn, by a speed that the same table has beside its counter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.importing import roles
from fiohost.importing import units as u
from fiohost.importing.clock import Clock
from fiohost.importing.raw import FloatArray, RawTable
from fiohost.importing.roles import Head
from fiohost.importing.units import MAP_UNITS

LEAST_TURNS = 2.0  # of travel: less is a matter of a few counts
AGREE = 5e-3  # by so much of itself the first half of the travel and the second may differ
SURE = 5e-4  # within it a whole number is taken, else three digits
ROUNDED = 3


def turn_by_speed(
    tables: Sequence[RawTable], heads: Sequence[Head], counter: str, wrap: float, clock: Clock
) -> tuple[float, str] | None:
    """Counts of a turn and the column of speed that says them; None where none does, or it does not agree with the
    counter, which begins anew at *wrap* (0: nowhere). *tables* are those of a bench with the same columns: all together
    they say one number.
    """
    for head in heads:
        deg_s = _deg_s(head)
        if deg_s == 0.0 or head.column.name == counter or head.score(roles.REFERENCE) >= head.score(roles.OUTPUT):
            continue
        of = head.column.name
        alike = [table for table in tables if table.column(of).kind == head.column.kind]
        pairs = [_travelled(table, counter, wrap, of, deg_s, clock) for table in alike]
        halves = [_counts_a_turn([(c[half], t[half]) for c, t in pairs for half in _halves(t)[i::2]]) for i in (0, 1)]
        whole = _counts_a_turn(pairs)
        apart = abs(halves[0] - halves[1])
        if sum(float(np.ptp(t)) for _, t in pairs if len(t)) < LEAST_TURNS or not apart < AGREE * whole:
            continue
        if abs(whole - round(whole)) < SURE * whole and apart < 2.0 * SURE * whole:
            return float(round(whole)), of
        return float(f"{whole:.{ROUNDED}g}"), of
    return None


def _deg_s(head: Head) -> float:
    """What one of a column's unit is in degrees per second, 0 where it is no speed of known unit."""
    if head.unit is not None:
        known = head.unit.measures == u.SPEED and head.unit.base in MAP_UNITS
        factor = MAP_UNITS[head.unit.base][2] * head.unit.scale if known else 0.0
        return factor if np.isfinite(factor) else 0.0
    return MAP_UNITS["rpm"][2] if head.words & {"rpm", "drehzahl"} else 0.0


def _travelled(
    table: RawTable, counter: str, wrap: float, speed: str, deg_s: float, clock: Clock
) -> tuple[FloatArray, FloatArray]:
    """Counts and turns since the first row, each (rows,), the turns summed up from the speed; rows with gaps are left
    out.
    """
    counts, turns_s = table.column(counter).values, table.column(speed).values * deg_s / 360.0
    if clock.column is None:
        times = np.arange(len(counts)) * clock.sample_time_s
    else:
        times = table.column(clock.column).values * clock.scale
    whole = np.isfinite(counts) & np.isfinite(turns_s) & np.isfinite(times)
    counts, turns_s, times = counts[whole], turns_s[whole], times[whole]
    if wrap:
        counts = np.unwrap(counts, period=wrap)
    steps = np.diff(times, prepend=times[:1])
    return counts - counts[:1], np.cumsum(turns_s * steps)


def _halves(turns: FloatArray) -> list[slice]:
    return [slice(0, len(turns) // 2), slice(len(turns) // 2, len(turns))]


def _counts_a_turn(pairs: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    """The common slope of counts over turns by least squares, each pair with an offset of its own; 0 of no travel."""
    moved = [(c - c.mean(), t - t.mean()) for c, t in pairs if len(t)]
    power = sum(float(t @ t) for _, t in moved)
    return abs(sum(float(c @ t) for c, t in moved)) / power if power > 0.0 else 0.0
