"""The score: deviance on left-out blocks, compared pair by pair with its standard error, and what speaks against a fit.

Blocks are left out by whole experiments (repeats of one together) or pieces of records; held-out records never come
here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.discover.settings import SETTINGS, SearchSettings
from fiohost.estimation.fit import Fit
from fiohost.estimation.intervals import Estimate, covariance, estimates
from fiohost.motor.effect import Parameter, effect
from fiohost.motor.model import Model

SCORE = SETTINGS.score


@dataclass(frozen=True)
class Gain:
    """How much less deviance one model leaves than another on left-out blocks, with its standard error.

    No block counts for more than a bound: a window that folded elsewhere decides nothing. ``most`` is the largest gain
    of a block.
    """

    total: float
    error: float
    most: float

    @classmethod
    def of(cls, before: np.ndarray, after: np.ndarray, settings: SearchSettings = SETTINGS) -> Gain:
        bound = settings.most_of_a_block
        gains = np.clip(before - after, -bound, bound)
        return cls(float(gains.sum()), float(gains.std(ddof=1)) * float(np.sqrt(len(gains))), float(gains.max()))

    @property
    def by_one(self) -> bool:
        """Whether one block carries it."""
        return self.total <= 2.0 * self.most

    def sure(self, settings: SearchSettings = SETTINGS) -> bool:
        """Whether it is one, within what the blocks can tell."""
        return self.total >= settings.sure_sigmas * self.error

    def tells_apart(self, settings: SearchSettings = SETTINGS) -> bool:
        """Whether it speaks strongly against the other of two models. Where both say nearly the same, so do blocks of
        data: a difference may be sure, and so small that the other is nearly as likely.
        """
        return self.sure(settings) and self.total >= settings.strong_deviance


def objection(found: Fit, name: str, replicas: Sequence[Model] = ()) -> str | None:
    """Why a fitted effect cannot be believed by its parameters alone, or None; replicas as for ``estimates``."""
    return at_a_bound(found, name, replicas) or _vanishing(found, name, _smooth(found, name, replicas))


def vanishes(found: Fit, name: str) -> bool:
    """Whether a fitted effect may as well not be there, by its parameters alone."""
    return _vanishing(found, name, _smooth(found, name)) is not None


def at_a_bound(found: Fit, name: str, replicas: Sequence[Model] = ()) -> str | None:
    """Which parameter of a fitted effect went as far as it may, or None."""
    full = found.model.full_deg_s
    bounds = (_at_a_bound(p, value, full) for p, value in _smooth(found, name, replicas))
    return next((why for why in bounds if why), None)


def _smooth(found: Fit, name: str, replicas: Sequence[Model] = ()) -> list[tuple[Parameter, Estimate]]:
    known = estimates(found, replicas)
    return [(p, known[f"{name}.{p.name}"]) for p in effect(name).parameters if p.is_smooth]


def _at_a_bound(parameter: Parameter, value: Estimate, full: float) -> str | None:
    if value.at_bound and (value.value != 0.0 or parameter.neutral is not None):
        # Nothing in nature is below zero; any other bound is one of the search.
        return f"{parameter.name} went to its bound {value.value:g} {parameter.unit}"
    if parameter.by_speed > 0.0 and value.value > full:
        return f"{parameter.name} went beyond the motor's full speed, to {value.value:.4g} {parameter.unit}"
    return None


def _vanishing(found: Fit, name: str, known: Sequence[tuple[Parameter, Estimate]]) -> str | None:
    """What says that the effect may as well not be there; one of several sizes is not distinct from none unless all
    are, together (Wald's test): data may know their difference and nothing of their sum.
    """
    # A ragged parameter has no width by gradients: the fit and the left-out records judge it.
    sizes = [(p, value, p.neutral) for p, value in known if p.neutral is not None and not p.ragged]
    whys = []
    for parameter, value, neutral in sizes:
        if abs(value.value - neutral) < 1e-9:
            whys.append(f"{parameter.name} went to {neutral:g}, where the effect vanishes")
        elif value.half_width / 1.96 * SCORE.sigmas_from_neutral > abs(value.value - neutral):
            whys.append(f"{parameter.name} is not distinct from {neutral:g}, where the effect vanishes")
    if len(whys) == len(sizes) > 1:
        cov, _ = covariance(found)
        at = [found.names.index(f"{name}.{p.name}") for p, _, _ in sizes]
        away = np.array([value.value - neutral for _, value, neutral in sizes])
        block = cov[np.ix_(at, at)]
        if (
            np.isfinite(block).all()
            and away @ np.linalg.pinv(block, hermitian=True) @ away > SCORE.sigmas_from_neutral**2
        ):
            return None
    return whys[0] if whys and len(whys) == len(sizes) else None
