"""What a finished diagnosis means for what to do next."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from fiohost.discover.next_experiment import NextExperiment, Offer, propose
from fiohost.discover.search import Progress

if TYPE_CHECKING:
    from fiohost.discover.diagnose import Diagnosis


@dataclass(frozen=True)
class Outlook:
    """``next_experiment`` of a menu, None where none is called for."""

    next_experiment: NextExperiment | None = None


def look_ahead(found: Diagnosis, offers: Sequence[Offer], *, say: Progress = lambda text: None) -> Diagnosis:
    """The diagnosis with its outlook; ``offers`` are the experiments that could be run."""
    began = time.monotonic()
    with threadpool_limits(limits=1, user_api="blas"):
        upcoming = propose(
            found.verdict, found.final, found.steps, found.train, found.horizon_s, found.residual, offers, say
        )
    return replace(found, outlook=Outlook(upcoming), seconds=found.seconds + time.monotonic() - began)
