"""Which effects could account for the residual: the score test, one simulation a trial.

The signature of an effect is what adding it at a trial size changes in the free run, with everything that the model's
own parameters and the initial states could imitate projected out. The share of the residual's power along it is its
score.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.identify.fit import Fit, project
from fiohost.identify.predict import Flat, free_output
from fiohost.identify.record import ANGLE, Record
from fiohost.motor.effect import Effect, Value, effects
from fiohost.motor.model import Model

BLOCKS_A_RECORD = 10
FLIPS = 400


@dataclass(frozen=True)
class Score:
    """One effect against the residual: the best share of its power over the trials, and the trials, best first."""

    effect: Effect
    share: float
    trials: tuple[dict[str, Value], ...]
    signature: np.ndarray


def candidates(model: Model, records: Sequence[Record], library: Sequence[str] | None = None) -> list[Effect]:
    """Effects that may be added to a model: those of the library that are not in it and can act on such records."""
    names = effects() if library is None else library
    rotary = all(r.rotary and r.kind == ANGLE for r in records)
    chosen = [effects()[n] for n in names if n != "linear" and n not in model.effects]
    return [e for e in chosen if e.trials and (rotary or not e.angle_bound)]


class Screen:
    """Signatures of candidates around one fit, and the residual they are held against, over all records (n)."""

    def __init__(self, fit: Fit, records: Sequence[Record]) -> None:
        self.fit = fit
        self.records = records
        flat = Flat.of(fit.model)
        self._base = [free_output(r, flat, s) for r, s in zip(records, fit.starts, strict=True)]
        jacobian = np.vstack(fit.jacobians) if fit.names else np.empty((fit.samples, 0))
        norms = np.linalg.norm(jacobian, axis=0)
        self._own, _ = np.linalg.qr(jacobian[:, norms > 0] / norms[norms > 0])
        self.residual = self.clean([r for r in fit.residuals])
        self.power = float(self.residual @ self.residual)

    def clean(self, series: Sequence[np.ndarray]) -> np.ndarray:
        """Series of all records as one (n), without what initial states and the model's parameters can imitate."""
        parts = [project(s[:, None], n)[:, 0] for s, n in zip(series, self.fit.nuisances, strict=True)]
        flat = np.concatenate(parts)
        return np.asarray(flat - self._own @ (self._own.T @ flat))

    def signature(self, effect: Effect, trial: dict[str, Value]) -> np.ndarray:
        """Unit signature (n) of an effect at a trial size; zero where it shows nothing."""
        model = self.fit.model.with_effect(effect.name, trial)
        flat = Flat.of(model)
        change = [
            free_output(r, flat, s) - b for r, s, b in zip(self.records, self.fit.starts, self._base, strict=True)
        ]
        cleaned = self.clean(change)
        size = float(np.linalg.norm(cleaned))
        raw = float(np.sqrt(sum(float(c @ c) for c in change)))
        return cleaned / size if size > 1e-6 * max(raw, 1e-12) and size > 0 else np.zeros_like(cleaned)

    def score(self, effect: Effect) -> Score:
        """Best share of the residual's power over the effect's trials, with the sign that physics allows."""
        one_sided = all(p.neutral is None or p.lower >= p.neutral or p.upper <= p.neutral for p in effect.parameters)
        rated = []
        for trial in effect.trials:
            signature = self.signature(effect, dict(trial))
            along = float(signature @ self.residual)
            share = along * along / self.power if self.power > 0 else 0.0
            rated.append((share if along > 0 or not one_sided else -share, dict(trial), signature))
        rated.sort(key=lambda item: item[0], reverse=True)
        best = rated[0]
        return Score(effect, max(best[0], 0.0), tuple(t for _, t, _ in rated), best[2])


def chance_share(
    screen: Screen,
    scores: Sequence[Score],
    replicas: Callable[[np.random.Generator], list[np.ndarray]] | None,
    rng: np.random.Generator,
    level: float = 0.99,
    draws: int = 60,
) -> float:
    """Share of the residual's power that the best of all candidates reaches by chance, at the given level.

    Two worlds without any missing effect, the larger counts: the residual itself with random signs in blocks of time,
    which keeps its colour and power, and replicas of the fitted model through the sensor.
    """
    signatures = np.column_stack([s.signature for s in scores])
    lengths = [len(r) for r in screen.records]
    blocks = np.concatenate([np.arange(n) * BLOCKS_A_RECORD // n + BLOCKS_A_RECORD * i for i, n in enumerate(lengths)])
    order = np.flatnonzero(np.diff(blocks, prepend=-1))
    sums = np.add.reduceat(signatures * screen.residual[:, None], order, axis=0)
    signs = rng.choice((-1.0, 1.0), size=(FLIPS, len(sums)))
    flipped = np.max((signs @ sums) ** 2, axis=1) / screen.power
    chance = float(np.quantile(flipped, level))
    if replicas is not None:
        worst = []
        for _ in range(draws):
            noise = screen.clean(replicas(rng))
            worst.append(float(np.max((noise @ signatures) ** 2)) / screen.power)
        # The largest of many draws stands for the level, with a margin for its own scatter.
        chance = max(chance, 1.5 * float(np.max(worst)))
    return chance
