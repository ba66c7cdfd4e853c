"""Does the bench repeat itself? Speeds of records whose commands are the same, held against each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fiohost.checks.finding import Finding
from fiohost.estimation.record import ANGLE, Record
from fiohost.estimation.repeats import repeats

# Speeds are means over so long; they differ where they do by this share of the speed, and by so many steps of the
# sensor over that time.
OVER_S, SHARE, STEPS = 0.5, 0.01, 4.0


def differing(records: Sequence[Record]) -> Iterator[Finding]:
    """Of every experiment that was run more than once and came out otherwise, by how much."""
    for group in repeats(records):
        members = [records[i] for i in group]
        speeds = np.array([_speeds(r) for r in members])
        mean = speeds.mean(axis=0)
        apart = float(np.sqrt(np.mean((speeds - mean) ** 2) * len(group) / (len(group) - 1)))
        top = float(np.sqrt(np.mean(mean**2)))
        first = members[0]
        step = first.quantum / OVER_S if first.kind == ANGLE else first.quantum
        if top > 0.0 and apart > max(SHARE * top, STEPS * step):
            names = ", ".join(r.name for r in members)
            advice = (
                f"the same commands as in {names}, but speeds differ by {100.0 * apart / top:.2g} % rms from run to "
                "run: what the bench itself does not repeat no model can foretell"
            )
            yield Finding(members[0].name, "not_repeated", False, len(group), (), advice)


def _speeds(record: Record) -> np.ndarray:
    """Mean speeds (m) of consecutive pieces, in the output's unit per second, or its unit where that is a speed."""
    n = max(1, round(OVER_S / record.sample_time_s))
    times = record.excitation.times_s
    rows = np.arange(0, len(record), n)
    if record.kind == ANGLE:
        return np.asarray(np.diff(record.y[rows]) / np.diff(times[rows]))
    return np.array([record.y[a : a + n].mean() for a in rows[:-1]])
