"""What chance gains: each effect by its own freedom, the whole library at one rate."""

from __future__ import annotations

import numpy as np
from bench_data import measure, steps, truth_model

from fiohost.discover.logs.bootstrap import BoundedDirections, draw_null
from fiohost.discover.logs.screen import Screen
from fiohost.discover.settings import SETTINGS
from fiohost.estimation.fit import fit
from fiohost.judging.levels import levels_of

# Sizes, phases of ten runs at three orders, and whatever lies between.
SIGMAS = SETTINGS.gumbel_sigmas
FREEDOMS = np.array([1] * 12 + [2] * 8 + [4] * 6 + [10, 33, 60])


def gained(rng: np.random.Generator, draws: int) -> np.ndarray:
    """What each of a library gains where nothing is missing (draws, effects)."""
    return rng.chisquare(np.broadcast_to(FREEDOMS, (draws, len(FREEDOMS))))


def test_a_size_is_not_asked_for_what_sixty_phases_gain() -> None:
    levels = levels_of(gained(np.random.default_rng(1), SETTINGS.draws), SIGMAS)
    assert 9.0 < np.median(levels[FREEDOMS == 1]) < 22.0
    assert levels[FREEDOMS == 60].item() > 80.0


def test_one_of_a_hundred_draws_passes_the_levels_of_the_whole_library() -> None:
    rng = np.random.default_rng(2)
    shares = []
    for _ in range(40):
        levels = levels_of(gained(rng, SETTINGS.draws), SIGMAS)
        shares.append(np.mean((gained(rng, 500) > levels).any(axis=1)))
    assert 0.002 < np.mean(shares) < 0.05


def test_what_leaves_no_trace_has_no_level_of_its_own() -> None:
    gains = gained(np.random.default_rng(3), SETTINGS.draws)
    gains[:, 5] = 0.0
    assert levels_of(gains, SIGMAS)[5] == 0.0
    assert (levels_of(gains, SIGMAS)[:5] > 0.0).all()


def test_one_window_in_which_a_shaft_stuck_does_not_say_what_all_reach() -> None:
    rng = np.random.default_rng(4)
    edges, rows = np.arange(0, 1500, 50), 1500
    basis = np.linalg.qr(rng.standard_normal((rows, 3)))[0].astype(np.float32)
    bounded = BoundedDirections(basis, edges, 1.0)
    white = rng.standard_normal(rows).astype(np.float32)
    np.testing.assert_allclose(bounded.along(white), white @ basis, atol=0.25)  # hardly any window is beyond its bound
    stuck = white.copy()
    stuck[500:550] += 40.0 * basis[500:550, 0] / np.linalg.norm(basis[500:550, 0])
    assert (stuck - white) @ basis[:, 0] > 5.0
    assert abs(bounded.along(stuck)[0] - bounded.along(white)[0]) < 1.2


def test_few_samples_are_drawn_where_they_decide_and_are_the_first_of_all() -> None:
    rng = np.random.default_rng(5)
    records = [measure(truth_model(), steps(4.0, rng), rng)]
    found = fit(truth_model(), records, windows=True)
    screen = Screen(found, records, ())

    def drawn(decided: bool) -> tuple[float, ...]:
        return draw_null(found, records, screen, [], np.random.default_rng(6), decided=lambda null: decided).unevenness

    few, whole = drawn(True), drawn(False)
    assert (len(few), len(whole)) == (SETTINGS.draws_of_a_guide, SETTINGS.draws)
    assert whole[: len(few)] == few
