"""The sign of a command that has none: a column of two values beside it, such as the bit of a bridge."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.importing.found import Found
from fiohost.importing.raw import FloatArray
from fiohost.importing.roles import Head, words_of

DIRECTION_WORDS = frozenset({"dir", "direction", "richtung", "drehrichtung", "sign", "vorzeichen", "ccw", "reverse"})
BACKWARD_WORDS = frozenset({"ccw", "reverse"})  # whose larger value is backwards
LEAST_SHARE = 0.02  # of the driven rows for either value: less is a shaft that swings, measured
CLEAR = 0.2  # of the fast speed: from here on the shaft tells which value is forward


def direction_of(heads: Sequence[Head], duty: FloatArray, speed: FloatArray, found: Found) -> tuple[str, float] | None:
    """Column and its value for forward; None where the command (rows,) has a sign or no column tells one.

    *speed* (rows,) is that of the shaft in any unit. Where it has a sign, it says which value is forward.
    """
    if not duty.size or np.nanmin(duty) < 0.0:
        return None
    likely = [
        h for h in heads
        if words_of(h.name) & DIRECTION_WORDS and h.column.name not in found.used and not h.column.missing
        and len(np.unique(h.column.values)) == 2
    ]  # fmt: skip
    if len(likely) != 1:
        return None
    name, values = likely[0].column.name, likely[0].column.values
    low, high = (float(value) for value in np.unique(values))
    driven = np.isfinite(duty) & np.isfinite(speed) & (duty > 0.3 * np.nanmax(duty))
    rows = [driven & (values == value) for value in (low, high)]
    if min(np.count_nonzero(row) for row in rows) < LEAST_SHARE * np.count_nonzero(driven):
        return None
    forward = low if words_of(likely[0].name) & BACKWARD_WORDS else high
    found.used.add(name)
    means = [float(np.mean(speed[row])) for row in rows]
    fast = float(np.nanquantile(np.abs(speed), 0.9))
    if means[0] * means[1] < 0.0 and min(map(abs, means)) > CLEAR * fast:
        forward = low if means[0] > 0.0 else high
        found.lines.append(f"sign of the command: {name!r}, forward where it is {forward:g}, as the shaft turns")
    else:
        found.lines.append(f"sign of the command: {name!r}")
        found.assumed.append(f"the command is forward where {name!r} is {forward:g}")
    return name, forward
