"""Candidates that need not be settled on: the noise that is there already says that they gain too little."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.evidence import State
from fiohost.discover.logs.bootstrap import draw_null
from fiohost.discover.logs.job import Job, Logs
from fiohost.discover.logs.optimise import OPTIMISER, again
from fiohost.discover.logs.scores import Score
from fiohost.discover.logs.screen import Screen
from fiohost.estimation.fit import Fit
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

    def under_it(i: int) -> Fit:
        whitened = jobs[i].records is state.records
        return fits[i] if whitened else again(state.fit, fits[i].model, state.records, 12, OPTIMISER.near_enough)

    guide = replace(logs.settings, draws=logs.settings.draws_of_a_guide)
    null = draw_null(state.fit, state.records, screen, scores, np.random.default_rng(NULL_SEED), guide)
    least = logs.margin / logs.settings.plainly_told
    found = dict(zip(asked, each(under_it, asked), strict=True))
    if any(state.fit.cost - f.cost >= least * null.of(effects[i].name) for i, f in found.items()):
        return {}
    if not logs.white(state):
        return {}
    return {i: replace(state, fit=f, deviance=state.deviance - state.fit.cost + f.cost) for i, f in found.items()}
