"""Is the residual at its floor? Each figure of each record against the same figure of the replicas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.estimation.record import Record
from fiohost.judging.floor import Floor
from fiohost.judging.metrics import Judgement
from fiohost.judging.settings import VERDICT, Rule

WHOLE_RUN = ("free_run_rms", "bin_violation_pct")


@dataclass(frozen=True)
class Excess:
    """One figure of one record: its replicas have a ``mean`` and stand as high as ``limit``; above ``allowed``
    something is missed.
    """

    record: str
    figure: str
    value: float
    limit: float
    allowed: float
    mean: float

    @property
    def exceeded(self) -> bool:
        return self.value > self.limit


def _figure(judgement: Judgement, figure: str) -> float | None:
    if figure == "wide_windows_pct":
        return judgement.wide_windows_pct
    if figure == "bin_violation_pct":
        return judgement.weighed.outside_pct
    return judgement.weighed.rms if figure == "free_run_rms" else judgement.errors.window_rms


def _limit(rule: Rule, floor: Floor, draws: np.ndarray) -> float:
    mean, spread = float(draws.mean()), float(draws.std(ddof=1)) if len(draws) > 1 else 0.0
    top = max(mean + VERDICT.sigmas * spread, float(draws.max()), mean * rule.factor)
    if floor.source == "repeats":
        top = max(top, getattr(floor.errors, rule.figure) * rule.factor)
    return top * (rule.factor if not rule.by_scatter else 1.0) + rule.margin


def excesses(records: Sequence[Record], judgements: Sequence[Judgement], floors: Sequence[Floor]) -> list[Excess]:
    """Every tested figure of every record with its limit; figures that a record does not have are left out.

    Where repeats of an experiment scatter more than the counts, only the figures that scatter is known of are tested;
    where commands are missing, no figure of whole runs.
    """
    found = []
    for record, judgement, floor in zip(records, judgements, floors, strict=True):
        for rule in VERDICT.rules:
            value = _figure(judgement, rule.figure)
            draws = [_figure(d, rule.figure) for d in floor.draws]
            known = [d for d in draws if d is not None]
            if value is None or not known or (floor.source == "repeats" and not rule.by_scatter):
                continue
            if record.broken and rule.figure in WHOLE_RUN:
                continue
            limit = _limit(rule, floor, np.array(known))
            if rule.figure == "wide_windows_pct":  # one window more proves nothing
                limit = max(limit, max(known) + 100.5 / judgement.windows)
            allowed = float(np.hypot(limit, rule.counts * record.quantum)) + rule.points
            found.append(Excess(record.name, rule.figure, value, limit, allowed, float(np.mean(known))))
    return found


def far_above(found: Sequence[Excess]) -> bool:
    """Whether something stands so far above what is allowed that no more replicas will say otherwise."""
    return any(e.value > VERDICT.near * e.allowed for e in found)


def open_still(found: Sequence[Excess]) -> set[str]:
    """The records of which not all stands so low among its replicas that no more of them will say otherwise."""
    return {e.record for e in found if e.value > 0.5 * (e.mean + e.limit)}


def beyond(found: Sequence[Excess]) -> set[str]:
    """The records of which something stands above its limit."""
    return {e.record for e in found if e.exceeded}


def near_limit(found: Sequence[Excess]) -> bool:
    """Whether all that stands above its limit stands so little above it that more replicas may say otherwise."""
    above = [e for e in found if e.exceeded]
    return bool(above) and all(e.value < VERDICT.near * e.limit for e in above)


def at_floor(found: Sequence[Excess]) -> bool:
    return not any(e.exceeded for e in found)


def no_matter(found: Sequence[Excess]) -> bool:
    """Whether nothing stands so far above the floor that it would be missed."""
    return not any(e.value > e.allowed for e in found)
