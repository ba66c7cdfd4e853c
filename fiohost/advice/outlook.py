"""What a finished diagnosis means for what to do next."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from fiohost.advice.empirical import Empirical, empirical_term
from fiohost.advice.limit import Limit
from fiohost.advice.limits import detection_limits
from fiohost.advice.next_experiment import NextExperiment, Offer, propose
from fiohost.discover.candidate import Progress

if TYPE_CHECKING:
    from fiohost.discover.diagnose import Diagnosis


@dataclass(frozen=True)
class Outlook:
    """``next_experiment`` of a menu, None where none is called for; ``limits`` of what these data would have shown;
    an ``empirical`` term for what nothing explains.
    """

    next_experiment: NextExperiment | None = None
    limits: tuple[Limit, ...] = ()
    empirical: Empirical | None = None


def look_ahead(
    found: Diagnosis,
    offers: Sequence[Offer],
    *,
    limits: bool = False,
    library: Sequence[str] | None = None,
    say: Progress = lambda text: None,
    another_bench: bool = False,
) -> Diagnosis:
    """The diagnosis with its outlook; ``offers`` are the experiments that could be run, told in words where the logs
    are of ``another_bench`` than this program drives.

    Detection limits of the ``library`` are found where nothing is missing, and by ``limits`` where effects explain all.
    """
    began = time.monotonic()
    with threadpool_limits(limits=1, user_api="blas"):
        term, follows = None, next((d.variable for d in found.residual if d.significant), None)
        if found.verdict == "unexplained":
            say("describing what remains")
            term = empirical_term(found.final, found.train, np.random.default_rng(0))
            follows = term.variable if term else follows
        seen = found.preliminary.data.exercised
        upcoming = propose(found.verdict, found.final, found.steps, found.train, seen, follows, offers, say)
        upcoming = upcoming.for_another_bench() if upcoming and another_bench else upcoming
        sizes: list[Limit] = []
        # Beside what is there and unexplained, no size of anything else can be told.
        if found.final.follows and (limits or not found.steps):
            say("finding how small an effect would have been seen")
            sizes = detection_limits(found.final, found.train, library)
    return replace(
        found, outlook=Outlook(upcoming, tuple(sizes), term), seconds=found.seconds + time.monotonic() - began
    )
