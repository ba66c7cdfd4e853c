"""Candidates under the noise that is there already: where it says that they gain too little they need not be settled
on, and where they lack more beside, it is what they are judged by.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.evidence import State, whitened_deviance
from fiohost.discover.logs.bootstrap import draw_null
from fiohost.discover.logs.job import Job, Logs
from fiohost.discover.logs.optimise import OPTIMISER, again
from fiohost.discover.logs.scores import Score
from fiohost.discover.logs.screen import Screen
from fiohost.estimation.fit import Fit
from fiohost.estimation.record import Record
from fiohost.noise.runs import LOAD_EFFECT
from fiohost.workers import each

# The null has a stream of draws of its own, so that no other draw depends on it.
NULL_SEED = 3


def within_noise(
    logs: Logs,
    state: State,
    screen: Screen,
    scores: Sequence[Score],
    jobs: Sequence[Job],
    fits: Mapping[int, Fit],
) -> dict[int, State]:
    """The states of ``fits`` (by their places among the ``jobs``) that gain too little to be believed under any noise,
    where all of them do under the one that a ``state`` leaves and that is white: then it hides nothing, and none is
    settled on them. Chance is that of ``scores`` around the state in a ``screen``.

    Dry friction and a load are settled on at any rate: how runs differ takes up what they gain.
    """
    effects = {i: jobs[i].score.effect for i in fits}
    asked = [i for i, of in effects.items() if not (of.everywhere or of.name == LOAD_EFFECT)]
    if logs.exact or state.noise is None or not asked:
        return {}

    guide = replace(logs.settings, draws=logs.settings.draws_of_a_guide)
    null = draw_null(state.fit, state.records, screen, scores, np.random.default_rng(NULL_SEED), guide)
    least = logs.margin / logs.settings.plainly_told
    found = dict(zip(asked, each(lambda i: under_noise_of(state, fits[i], jobs[i].records), asked), strict=True))
    if any(state.fit.cost - s.fit.cost >= least * null.of(effects[i].name) for i, s in found.items()):
        return {}
    return found if logs.white(state) else {}


def under_noise_of(state: State, found: Fit, records: Sequence[Record]) -> State:
    """The state of a fit to windows of ``records`` under the noise that another ``state`` leaves."""
    if records is not state.records:
        found = again(state.fit, found.model, state.records, 12, OPTIMISER.near_enough)
    gain = whitened_deviance(state.fit) - whitened_deviance(found)
    return replace(state, fit=found, deviance=state.deviance - gain, bare=None)
