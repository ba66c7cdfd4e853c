"""Records of which nobody said when they were begun, taken for one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.candidate import Progress
from fiohost.discover.logs.whole_runs import WholeRuns
from fiohost.discover.search import Search
from fiohost.discover.step import Found
from fiohost.estimation.record import Record
from fiohost.judging.stage import Stage
from fiohost.motor.effect import effects
from fiohost.motor.model import Model


def in_sequence(records: Sequence[Record]) -> list[Record]:
    """The records as if each had been begun where the one before it ended."""
    began = np.cumsum([0.0, *(r.seconds for r in records)])
    return [
        replace(r, excitation=replace(r.excitation, clock_s=float(t))) for r, t in zip(records, began[:-1], strict=True)
    ]


def _by_one_clock(
    runs: WholeRuns, library: Sequence[str] | None, say: Progress, model: Model, from_file: bool
) -> Found[Stage] | None:
    """What a search over the records in sequence finds of effects that hang on the bench's own time, where none of
    several says when it was begun; None if nothing that explains them all.
    """
    names = [n for n in (effects() if library is None else library) if effects()[n].clocked]
    if len(runs.train) < 2 or any(r.excitation.clock_s != 0.0 for r in runs.train) or not names:
        return None
    say("the logs do not say when they were begun: as if taken one after the other")
    search = Search(WholeRuns(in_sequence(runs.train), runs.rng), names, say)
    root = search.declared(model, from_file)
    best = search.run(root)
    return replace(search.found(root, best), one_clock=True) if best.added and search.explains(best) else None
