"""The null: what each of the library gains by chance, and how white residuals of a true model are.

Parametric bootstrap (Efron 1979): data of the model as it stands, with the noise that is left, through the same sensor,
windows and scores.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.discover.logs.scores import Score, powers
from fiohost.discover.logs.screen import Screen
from fiohost.discover.null import Decided, Null
from fiohost.discover.settings import SETTINGS, SearchSettings
from fiohost.estimation.fit import Fit
from fiohost.estimation.record import Record
from fiohost.judging.floor import replica_errors, replicas_of
from fiohost.judging.levels import levels_of
from fiohost.noise.settings import SETTINGS as NOISE
from fiohost.noise.whiten import unevenness
from fiohost.workers import each


class BoundedDirections:
    """Projections on directions (n, k) to which no window, of those that begin at ``edges`` (m), adds more than some
    standard deviations of white noise: one in which the shaft stuck, and the model's did not, says nothing of what all
    others reach (bounded influence, Hampel 1974). ``block`` samples are one of the n.
    """

    def __init__(self, basis: np.ndarray, edges: np.ndarray, block: float) -> None:
        self.basis, self.ends = basis, [*zip(edges, [*edges[1:], len(basis)], strict=True)]
        # Window by window: of a long record, all products at once would fill the memory.
        lengths = np.array([np.sqrt(np.einsum("ij,ij->j", basis[a:b], basis[a:b])) for a, b in self.ends])
        self.most = (NOISE.most_of_a_window / np.sqrt(block) * lengths).astype(np.float32)

    def along(self, series: np.ndarray) -> np.ndarray:
        """The projections (k) of a series (n)."""
        parts = np.array([series[a:b] @ self.basis[a:b] for a, b in self.ends])
        return np.asarray(np.clip(parts, -self.most, self.most).sum(axis=0))


def draw_null(
    fitted: Fit,
    records: Sequence[Record],
    screen: Screen,
    scores: Sequence[Score],
    rng: np.random.Generator,
    settings: SearchSettings = SETTINGS,
    decided: Decided = lambda null: False,
) -> Null:
    """The null of a fit to ``records``, around which ``scores`` were taken in a ``screen``: by as many samples as a
    guide is drawn by where that has ``decided``.
    """
    directions = [d for s in scores for d in s.directions]
    owner = np.array([i for i, s in enumerate(scores) for _ in s.directions], dtype=int)
    columns = [np.empty((len(screen.residual), 0), np.float32), *(d.basis for d in directions)]
    basis = np.concatenate(columns, axis=1)
    widths = np.array([d.basis.shape[1] for d in directions], dtype=int)
    begins = np.cumsum(widths) - widths
    several = [i for i, d in enumerate(directions) if d.weights.shape[1] > 1]
    edges, replicas = [r.edges for r in records], replicas_of(fitted, records, anywhere=True)
    # The screen takes samples together: its powers are by so much below squared errors.
    block = float(np.mean([max(1, round(settings.screen.resolution_s / r.sample_time_s)) for r in records]))
    bounded = BoundedDirections(basis, screen.window_edges(), block) if fitted.windows else None

    def draw(rng: np.random.Generator) -> tuple[np.ndarray, float]:
        # What is gained is weighed by the noise that is found: it grows with that, whatever it is. How runs scatter few
        # of them say, and what they have in common is held against it.
        asked = bool(scores)
        errors = replica_errors(fitted, replicas, rng, open_noise=not asked, open_runs=asked)
        cleaned = screen.clean(errors).astype(np.float32)
        along = bounded.along(cleaned) if bounded else cleaned @ basis
        found, own = np.zeros(len(directions)), np.zeros(len(scores))
        if directions:
            found = np.add.reduceat(along**2, begins, dtype=np.float64)
        for i in several:
            found[i] = powers(along[None, begins[i] : begins[i] + widths[i]], directions[i].weights)[0]
        np.maximum.at(own, owner, found)
        variance = 1.0 if fitted.windows else float(np.mean(np.concatenate(errors) ** 2))
        return block * own / max(variance, 1e-300), unevenness(errors, edges) if fitted.windows else 0.0

    rngs, few = rng.spawn(settings.draws), settings.draws_of_a_guide
    drawn = each(draw, rngs[:few])
    first = _of(drawn, screen, scores, settings)
    if len(rngs) <= few or decided(first):
        return first
    return _of([*drawn, *each(draw, rngs[few:])], screen, scores, settings)


def _of(
    drawn: Sequence[tuple[np.ndarray, float]], screen: Screen, scores: Sequence[Score], settings: SearchSettings
) -> Null:
    """The null of what samples gain by each of the ``scores``, and how uneven they are."""
    gains = np.array([gain for gain, _ in drawn])  # (draws, effects)
    best = gains.max(axis=1, initial=0.0)
    level = float(best.mean() + settings.gumbel_sigmas * best.std(ddof=1))
    levels = dict(zip([s.effect.name for s in scores], levels_of(gains, settings.gumbel_sigmas).tolist(), strict=True))
    for effect in (s.effect for s in scores if s.effect.couples and not s.effect.angle_bound):
        levels[effect.name] = max(levels[effect.name], screen.by_lines)
    seen = {name: own for name, own in levels.items() if own > 0.0}
    return Null(max(level, screen.by_lines), seen, tuple(uneven for _, uneven in drawn))
