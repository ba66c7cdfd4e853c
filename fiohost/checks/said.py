"""What a log says beside its record: its direction bit, whether the command followed the output, what it states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from fiohost.bench.log import Log


@dataclass(frozen=True)
class Said:
    """Statements of one log that no fit uses, and which can be checked or which bound what the log can show.

    ``direction`` (n) is the decoder's bit, 0 counting up; ``delay_ticks`` as stated by somebody, ``bits`` whether C3
    and C4 are there; None and False where not. ``ambiguous`` counts rows before which another turn may hide.
    ``returns`` says that the shaft was brought back to where it began.
    """

    direction: np.ndarray | None = None
    closed_loop: bool = False
    delay_ticks: int | None = None
    bits: bool = False
    ambiguous: int = 0
    returns: bool = False


def said_by(log: Log) -> Said:
    """What a log says beside its record."""
    reference = log.columns.get("ref_deg")
    direction = log.columns.get("direction")
    return Said(
        direction=direction if direction is not None and bool(np.all(np.isfinite(direction))) else None,
        closed_loop=reference is not None and bool(np.any(np.isfinite(reference))),
        delay_ticks=log.command_delay_ticks if log.command_delay_stated else None,
        bits="c3" in log.columns and "c4" in log.columns,
        ambiguous=int(log.ambiguous_rows.size),
        returns=log.metadata.get("returns_to_start", "").strip().lower() in ("true", "1", "yes"),
    )
