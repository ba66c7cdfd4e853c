"""The null: what the best of the library gains by chance, and how white residuals of a true model are.

Parametric bootstrap (Efron 1979): data of the model as it stands, with the noise that is left, through the same sensor,
windows and scores. The level is the 99 % point of the best of the whole library.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.discover.objective import Objective, State
from fiohost.discover.screen import Score, Screen, powers
from fiohost.discover.settings import SETTINGS, SearchSettings
from fiohost.discover.workers import each
from fiohost.noise.whiten import unevenness


@dataclass(frozen=True)
class Null:
    """What bootstrap samples of a state reach: the ``level`` of deviance that the best of the library gains, and how
    uneven their residuals are.
    """

    level: float
    unevenness: tuple[float, ...]


def draw_null(
    objective: Objective,
    state: State,
    screen: Screen,
    scores: Sequence[Score],
    rng: np.random.Generator,
    settings: SearchSettings = SETTINGS,
) -> Null:
    """The null of a state, around which ``scores`` were taken in a ``screen``."""
    directions = [d for s in scores for d in s.directions]
    columns = [np.empty((len(screen.residual), 0), np.float32), *(d.basis for d in directions)]
    basis = np.concatenate(columns, axis=1)
    ends = np.cumsum([d.basis.shape[1] for d in directions])
    edges = [r.windows for r in state.records]
    # The screen takes samples together: its powers are by so much below squared errors.
    block = float(np.mean([max(1, round(settings.screen.resolution_s / r.sample_time_s)) for r in state.records]))

    def draw(rng: np.random.Generator) -> tuple[float, float]:
        errors = objective.draw(state, rng)
        along = screen.clean(errors).astype(np.float32) @ basis
        parts = zip(np.split(along[None, :], ends[:-1], axis=1)[: len(directions)], directions, strict=True)
        most = max((float(powers(p, d.weights)[0]) for p, d in parts), default=0.0)
        variance = 1.0 if objective.windows else float(np.mean(np.concatenate(errors) ** 2))
        return block * most / max(variance, 1e-300), unevenness(errors, edges) if objective.windows else 0.0

    drawn = each(draw, rng.spawn(settings.draws))
    best = np.array([gain for gain, _ in drawn])
    level = float(best.mean() + settings.gumbel_sigmas * best.std(ddof=1))
    level = max(level, screen.by_lines)
    return Null(level, tuple(uneven for _, uneven in drawn))
