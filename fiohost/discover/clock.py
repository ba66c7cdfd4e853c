"""The bench's own time, where logs do not tell it: each log's own, or as if they had been taken one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.search import Search, declared_alone, select
from fiohost.discover.step import Found
from fiohost.estimation.record import Record
from fiohost.motor.effect import effects
from fiohost.motor.model import Model


def clockless(records: Sequence[Record]) -> bool:
    """Whether there are several records and none says when it was begun."""
    return len(records) > 1 and all(r.excitation.clock_s == 0.0 for r in records)


def in_sequence(records: Sequence[Record]) -> list[Record]:
    """The records as if each had been begun where the one before it ended."""
    began = np.cumsum([0.0, *(r.seconds for r in records)])
    return [
        replace(r, excitation=replace(r.excitation, clock_s=float(t))) for r, t in zip(records, began[:-1], strict=True)
    ]


def by_one_clock(whole: Search, model: Model, from_file: bool) -> Found | None:
    """What a search over another's records in sequence finds of the effects that hang on the bench's own time; None if
    nothing that explains them all.
    """
    library, rng, say = whole.context.library, whole.context.rng, whole.context.say
    names = [n for n in (effects() if library is None else library) if effects()[n].clocked]
    if not clockless(whole.train) or not names:
        return None
    say("the logs do not say when they were begun: as if taken one after the other")
    search = Search(in_sequence(whole.train), rng, names, say)
    found = select(search, declared_alone(search, model, from_file))
    return replace(found, one_clock=True) if found.steps and found.final.follows else None
