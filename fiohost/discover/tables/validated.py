"""Candidates over tables, cross-validated by rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from fiohost.discover.candidate import Candidate
from fiohost.estimation.fit import Fit

# Squared errors this close are the same: left out, and fitted.
AS_GOOD_LEFT_OUT, CLOSE = 1.1, 1.03
# Those that come so much farther from the data than the best are not fitted to the end, or not cross-validated.
FAR, HOPELESS = 12.0, 4.0
LEAST_CV_GAIN = 0.01
# A rival has to gain this share of what the best does.
SHARED_GAIN = 0.8
MOST_EFFECTS = 4


@dataclass(frozen=True)
class Validated:
    """A fitted model and how it did on what it had not seen: squared errors (blocks) of every left-out record."""

    fit: Fit
    blocks: np.ndarray
    fold_costs: np.ndarray

    @property
    def cost(self) -> float:
        return float(self.blocks.sum())


@dataclass(frozen=True)
class Tried(Candidate):
    """A candidate with what left-out rows say of it."""

    validated: Validated | None = None


@dataclass(frozen=True)
class Outcome:
    """A round's candidates, the winner if one is earned, what speaks for it, and the left-out error it began from."""

    candidates: list[Tried]
    winner: Tried | None = None
    evidence: Mapping[str, object] = field(default_factory=dict)
    base_cost: float = np.inf


def checked(candidate: Tried, validated: Validated, base: Validated) -> Tried:
    """A cross-validated candidate, rejected where records that were left out do not gain by it."""
    gain = 1.0 - validated.cost / base.cost
    change = validated.fold_costs / np.maximum(base.fold_costs, 1e-300) - 1.0
    if gain < LEAST_CV_GAIN or np.sum(change < -LEAST_CV_GAIN) <= np.sum(change > LEAST_CV_GAIN):
        why = f"changes the error on left-out training records by {-100 * gain:+.1f} % only"
        return replace(candidate, rejected_because=why)
    return replace(candidate, validated=validated)


def beside(candidate: Tried, winner: Tried) -> Tried:
    """A candidate that could have been taken says how it did beside the one that was."""
    if candidate.effect == winner.effect or candidate.validated is None or winner.validated is None:
        return candidate
    ratio = float(np.sqrt(candidate.validated.cost / winner.validated.cost))
    return replace(candidate, rejected_because=f"leaves {ratio:.3g} times the left-out error of {winner.effect}")


def indistinguishable(best: Validated, rival: Validated, base_cost: float) -> bool:
    """Whether a rival does as well as the best on left-out data, within what the data can tell."""
    if rival.cost <= best.cost * CLOSE**2:
        return True
    gain, rival_gain = base_cost - best.cost, base_cost - rival.cost
    if rival_gain < SHARED_GAIN * gain:
        return False
    difference = rival.blocks - best.blocks
    error = float(difference.std(ddof=1)) * np.sqrt(len(difference))
    return bool(difference.sum() < 2.0 * error)
