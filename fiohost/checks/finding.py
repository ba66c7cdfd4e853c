"""A log under examination, and what an examination of its raw data finds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiohost.checks.counts import COUNT_NOISE, Counts
from fiohost.checks.said import Said
from fiohost.estimation.record import Record

TIMES_SHOWN = 5


@dataclass(frozen=True)
class Finding:
    """One fault of one log: how often, when first, what it is in a sentence, and whether a fit suffers by it."""

    log: str
    name: str
    harm: bool
    count: int
    times_s: tuple[float, ...]
    advice: str

    def to_json(self) -> dict[str, object]:
        return {
            "log": self.log,
            "name": self.name,
            "severity": "harm" if self.harm else "note",
            "count": self.count,
            "times_s": list(self.times_s),
            "advice": self.advice,
        }


@dataclass(frozen=True)
class Skipped:
    """A check that a log cannot be put to, and why."""

    log: str
    name: str
    why: str

    def to_json(self) -> dict[str, str]:
        return {"log": self.log, "name": self.name, "why": self.why}


@dataclass(frozen=True)
class Case:
    """One log under examination."""

    record: Record
    said: Said
    data: Counts

    def finding(self, name: str, harm: bool, where: np.ndarray, advice: str) -> Finding:
        """A finding at rows ``where``."""
        times = self.record.excitation.times_s[where[:TIMES_SHOWN]]
        return Finding(self.record.name, name, harm, len(where), tuple(float(t) for t in times), advice)

    def outweighs_counts(self, sizes: np.ndarray) -> bool:
        """Whether single wrong readings of these sizes in counts add as much to the log's error as its counts do."""
        return bool(np.sum(sizes**2) > COUNT_NOISE**2 * len(self.record))

    @property
    def top_speed(self) -> float:
        """Counts a tick."""
        return float(np.max(np.abs(self.data.speed())))
