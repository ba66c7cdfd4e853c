"""Records of one experiment, run again."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.estimation.record import Record


def repeats(records: Sequence[Record]) -> list[list[int]]:
    """Groups (two or more indices) of records whose commands are identical."""
    groups: dict[bytes, list[int]] = {}
    for i, record in enumerate(records):
        ex = record.excitation
        key = ex.duties_pct.tobytes() + ex.modes.tobytes() + np.round(ex.times_s, 6).tobytes()
        groups.setdefault(key, []).append(i)
    return [g for g in groups.values() if len(g) > 1]
