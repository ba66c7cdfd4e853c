"""One effect of the library in one round of the search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Candidate:
    """How one effect did: the share of the residual's power that it removed, and why it was not taken."""

    effect: str
    score: float
    rejected_because: str | None
