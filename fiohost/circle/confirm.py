"""Before and after on a record that took no part: the improvement and how sure it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fiohost.estimation.record import Record
from fiohost.judging.floor import Floor, floors
from fiohost.judging.metrics import Judgement, judge
from fiohost.judging.stage import Stage

DRAWS = 2000


@dataclass(frozen=True)
class Confirmation:
    """Both models on one fresh record; the improvement is of the one-second window error, in percent, with its
    interval.
    """

    record: Record
    before: Judgement
    after: Judgement
    floor: Floor
    improvement_pct: float
    ci95: tuple[float, float]

    def to_json(self) -> dict[str, Any]:
        return {
            "log": self.record.name,
            "before": self.before.errors.to_json(),
            "after": self.after.errors.to_json(),
            "floor": self.floor.errors.to_json(),
            "improvement_pct": self.improvement_pct,
            "ci95": list(self.ci95),
            "improvement_of": "window_rms",
            "windows": len(self.record.windows) - 1,
        }


def improvement(
    before: np.ndarray, after: np.ndarray, edges: np.ndarray, rng: np.random.Generator
) -> tuple[float, tuple[float, float]]:
    """By how many percent the rms of residuals (n) fell, with a 95 % interval from resampled windows (m + 1 edges)."""
    squares = np.array(
        [[float(r[a:b] @ r[a:b]) for r in (before, after)] for a, b in zip(edges[:-1], edges[1:], strict=True)]
    )
    picks = rng.integers(len(squares), size=(DRAWS, len(squares)))
    sums = squares[picks].sum(axis=1)
    total = squares.sum(axis=0)

    def percent(pair: np.ndarray) -> np.ndarray:
        return np.asarray(100.0 * (1.0 - np.sqrt(pair[..., 1] / np.maximum(pair[..., 0], 1e-300))))

    low, high = np.quantile(percent(sums), (0.025, 0.975))
    return float(percent(total)), (float(low), float(high))


def confirm(record: Record, declared: Stage, final: Stage, seed: int = 0) -> Confirmation:
    """Judge the declared and the final model on a fresh record."""
    rng = np.random.default_rng(seed)
    before, after = judge(record, declared.fit.model), judge(record, final.fit.model)
    gain, bounds = improvement(before.window_residual, after.window_residual, record.windows, rng)
    floor = floors([record], final.fit.model, [after], final.scattered_models, rng)[0]
    return Confirmation(record, before, after, floor, gain, bounds)
