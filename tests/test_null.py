"""What chance gains: each effect by its own freedom, the whole library at one rate."""

from __future__ import annotations

import numpy as np

from fiohost.discover.null import levels_of
from fiohost.discover.settings import SETTINGS

# Sizes, phases of ten runs at three orders, and whatever lies between.
FREEDOMS = np.array([1] * 12 + [2] * 8 + [4] * 6 + [10, 33, 60])


def gained(rng: np.random.Generator, draws: int) -> np.ndarray:
    """What each of a library gains where nothing is missing (draws, effects)."""
    return rng.chisquare(np.broadcast_to(FREEDOMS, (draws, len(FREEDOMS))))


def test_a_size_is_not_asked_for_what_sixty_phases_gain() -> None:
    levels = levels_of(gained(np.random.default_rng(1), SETTINGS.draws), SETTINGS)
    assert 9.0 < np.median(levels[FREEDOMS == 1]) < 22.0
    assert levels[FREEDOMS == 60].item() > 80.0


def test_one_of_a_hundred_draws_passes_the_levels_of_the_whole_library() -> None:
    rng = np.random.default_rng(2)
    shares = []
    for _ in range(40):
        levels = levels_of(gained(rng, SETTINGS.draws), SETTINGS)
        shares.append(np.mean((gained(rng, 500) > levels).any(axis=1)))
    assert 0.002 < np.mean(shares) < 0.05


def test_what_leaves_no_trace_has_no_level_of_its_own() -> None:
    gains = gained(np.random.default_rng(3), SETTINGS.draws)
    gains[:, 5] = 0.0
    assert levels_of(gains, SETTINGS)[5] == 0.0
    assert (levels_of(gains, SETTINGS)[:5] > 0.0).all()
