"""What is left out in turn: whole experiments, or pieces of records where there are fewer than three."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiohost.errors import DataError
from fiohost.estimation.record import ANGLE, SHORTEST, Record, make_record
from fiohost.estimation.repeats import repeats

# Edges move by a quarter of a piece at most: so two pieces, and more of twice the shortest, are long enough.
SHORTEST_CUT = 3 * SHORTEST


def slices(record: Record, pieces: int) -> list[Record]:
    """A record cut into consecutive pieces, each with an initial state of its own."""
    edges = _quiet_edges(record.excitation.duties_pct[1:], pieces)
    pairs = zip(edges[:-1], edges[1:], strict=True)
    return [piece(record, a, b, f"{record.name} [{i + 1}/{pieces}]") for i, (a, b) in enumerate(pairs)]


def beginning(record: Record, seconds: float) -> Record:
    """The first of consecutive pieces of a record that are about so long; the record itself where it is no longer."""
    pieces = int(record.seconds / seconds)
    if pieces < 2:
        return record
    edges = _quiet_edges(record.excitation.duties_pct[1:], pieces)
    return piece(record, 0, edges[1], f"{record.name} [1/{pieces}]")


def piece(record: Record, first: int, end: int, name: str) -> Record:
    """The samples of a record from ``first`` up to ``end``, with an initial state of their own."""
    ex, a, b = record.excitation, first, end
    found = make_record(
        name,
        ex.times_s[a:b],
        ex.duties_pct[1:][a:b],
        record.y[a:b],
        mode=ex.modes[1:][a:b],
        kind=record.kind,
        unit=record.unit,
        quantum=record.quantum,
        sample_time_s=record.sample_time_s,
        command_delay_s=float(ex.act_times_s[0] - ex.times_s[0]),
        rotary=record.rotary,
        clock_s=ex.clock_s + float(ex.times_s[a]),
        own_zero=record.own_zero,
        segments=record.segments[a:b],
    )
    found = replace(
        found,
        regular=record.regular,
        quantum_found=record.quantum_found,
        noise_rms=record.noise_rms,
        average=record.average,
    )
    if record.kind != ANGLE:
        found = replace(found, begun_deg=float(record.angles()[a]))
    if a == 0:
        return replace(found, begins=record.begins)
    duties, modes = found.excitation.duties_pct.copy(), found.excitation.modes.copy()
    duties[0], modes[0] = ex.duties_pct[a], ex.modes[a]
    return replace(found, at_rest=False, excitation=replace(found.excitation, duties_pct=duties, modes=modes))


def _quiet_edges(duties_pct: np.ndarray, pieces: int) -> list[int]:
    """Where commands (n) are cut into about equal pieces: each edge as far from any change of the command as it can be.

    Cut at a change, a lag could only be told from how a speed settles, no longer from the way that it costs.
    """
    n = len(duties_pct)
    changes = np.concatenate(([0], np.flatnonzero(np.diff(duties_pct)) + 1, [n]))
    edges = np.linspace(0, n, pieces + 1).astype(int)
    reach = n // (4 * pieces)
    found = [0]
    for edge in edges[1:-1]:
        near = np.arange(edge - reach, edge + reach + 1)
        after = np.searchsorted(changes, near, side="right")
        away = np.minimum(near - changes[after - 1], changes[after] - near)
        best = near[away == away.max()]
        found.append(int(best[np.argmin(np.abs(best - edge))]))
    return [*found, n]


def folds(records: Sequence[Record], most: int = 6) -> tuple[list[Record], list[list[int]]]:
    """The records to fit, and the groups of them to leave out in turn.

    Groups are whole experiments, repeats together; where there are fewer than three, records are cut in time and the
    pieces are left out.
    """
    experiments = [*repeats(records)]
    grouped = {i for g in experiments for i in g}
    experiments.extend([i] for i in range(len(records)) if i not in grouped)
    counts = [1] * len(records)
    if len(experiments) < 3:
        for record in records:
            if len(record) < SHORTEST_CUT:
                raise DataError(
                    f"{record.name}: {len(record)} samples are too few to be cut in pieces, as is done with fewer than "
                    f"three experiments; at least {SHORTEST_CUT} are needed"
                )
        counts = [max(2, min(4, int(r.seconds // 4), len(r) // (2 * SHORTEST))) for r in records]
    pieces: list[Record] = []
    where: list[list[int]] = []
    for record, count in zip(records, counts, strict=True):
        where.append(list(range(len(pieces), len(pieces) + count)))
        pieces.extend([record] if count == 1 else slices(record, count))
    if len(experiments) < 3:
        parts = [list(part) for w in where for part in np.array_split(np.array(w), min(4, len(w)))]
        groups = [[int(i) for i in part] for part in parts]
    else:
        groups = [[j for i in g for j in where[i]] for g in experiments]
    while len(groups) > most:
        groups.sort(key=lambda g: sum(len(pieces[i]) for i in g))
        groups = [groups[0] + groups[1], *groups[2:]]
    return pieces, groups
