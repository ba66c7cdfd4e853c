"""What a screen says of an effect: the ways in which it may act, and where a fit of it begins."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fiohost.discover.trials import Trial
from fiohost.motor.effect import Effect


@dataclass(frozen=True)
class Direction:
    """One way in which an effect may act: trial values, and the orthonormal signatures (n, k) they leave.

    ``share`` is the part of the residual's power along them, zero where physics forbids the sign; ``as_it_is`` what the
    trial removes of that power at the size that it has. Of an effect bound to
    the angle there is, for each of its sizes, a sine and a cosine for each zero of angle that the logs have: one size,
    a phase each, so ``weights`` (sizes, zeros) are what belongs together. ``own`` are the model's own parameters beside
    the trial, as least squares have them.
    """

    trial: Trial
    basis: np.ndarray
    share: float
    weights: np.ndarray = field(default_factory=lambda: np.ones((1, 1)))
    as_it_is: float = 0.0
    own: Trial = field(default_factory=dict)


@dataclass(frozen=True)
class Score:
    """One effect against the residual: its directions, best first, and the trials from which to refit it.

    ``raw`` are the trials as the library gives them, the best first: a size that grows from nothing says little of an
    effect whose other parameters shape it. ``own`` are the model's own parameters beside each of ``trials``. Those that
    are ``far`` leave so much more than there was that no few steps in windows lead back from them.
    """

    effect: Effect
    share: float
    trials: tuple[Trial, ...]
    directions: tuple[Direction, ...]
    raw: tuple[Trial, ...] = ()
    own: tuple[Trial, ...] = ()
    far: tuple[Trial, ...] = ()


def powers(along: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Power (draws) of projections (draws, k) along signatures; ``weights`` (sizes, zeros) are those of equal groups of
    them whose sizes belong together.
    """
    if weights.shape[1] == 1:
        return np.asarray((along**2).sum(axis=1, dtype=np.float64))
    groups = np.linalg.norm(along.reshape(len(along), *weights.shape, -1), axis=3)
    return np.asarray(((groups * weights).sum(axis=2) ** 2).sum(axis=1))


def _scaled(effect: Effect, trial: Trial, factor: float) -> tuple[Trial, float]:
    """A trial grown to the size that the residual asks for, within bounds, and by how much; as it is where it has no
    single size.
    """
    sized = [p for p in effect.parameters if p.neutral is not None and p.is_smooth]
    if len(sized) != 1 or not np.isfinite(factor):
        return trial, 1.0
    parameter = sized[0]
    neutral = float(parameter.neutral or 0.0)
    size = float(trial[parameter.name]) - neutral
    value = float(np.clip(neutral + factor * size, parameter.lower, parameter.upper))
    return {**trial, parameter.name: value}, (value - neutral) / size if size else 1.0
