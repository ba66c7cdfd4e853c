"""Lines of the clock in what a model leaves, and the screen's trials of what swings."""

from __future__ import annotations

import numpy as np
import pytest

from fiohost.discover.logs.lines import Series, clock_lines
from fiohost.discover.logs.offered import candidates
from fiohost.discover.logs.screen import Screen
from fiohost.discover.logs.whole_runs import WholeRuns
from fiohost.estimation.fit import fit_from_scratch
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import Record, make_record
from fiohost.motor.effect import Span, effect
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start

STEP_S, SECONDS = 0.02, 30.0
LINEAR = {"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.08}


def coloured(rng: np.random.Generator) -> np.ndarray:
    """What is left of a run without a line: noise whose low frequencies are strong."""
    white = rng.standard_normal(round(SECONDS / STEP_S))
    return np.asarray(np.convolve(white, np.exp(-np.arange(50) / 10.0))[: len(white)])


def levels(rng: np.random.Generator) -> np.ndarray:
    return np.repeat(rng.uniform(-80.0, 80.0, round(SECONDS)), round(1.0 / STEP_S))


def test_a_line_of_the_clock_is_found_among_coloured_noise_by_the_time_of_all_records() -> None:
    rng = np.random.default_rng(1)
    parts = []
    for clock in (0.0, 31.3, 70.2):
        times = clock + np.arange(round(SECONDS / STEP_S)) * STEP_S
        line = 2.0 * np.sin(2.0 * np.pi * 1.5625 * times + 1.0)
        parts.append(Series(coloured(rng) + line, levels(rng), STEP_S, clock))
    assert clock_lines(parts)[0] == pytest.approx(1.5625, abs=0.003)  # a tenth of what one record tells apart


def test_a_gain_that_swings_has_its_line_in_what_is_left_as_a_share_of_the_command() -> None:
    rng = np.random.default_rng(4)
    times = np.arange(round(SECONDS / STEP_S)) * STEP_S
    duty = levels(rng)
    left = coloured(rng) + 0.05 * np.sin(2.0 * np.pi * 1.5625 * times + 1.0) * duty
    parts = [Series(left, duty, STEP_S, 0.0)]
    assert clock_lines([Series(left, np.full(len(left), 50.0), STEP_S, 0.0)]) == []  # not in itself
    assert clock_lines(parts)[0] == pytest.approx(1.5625, abs=0.02)


def test_a_line_beside_one_of_another_kind_is_another_line_where_the_clock_tells_them_apart() -> None:
    """A gain that swings beside a torque that does, closer than one record tells apart."""
    parts = []
    for run, clock in enumerate((0.0, 31.3, 70.2)):
        rng = np.random.default_rng(run)
        times = clock + np.arange(round(SECONDS / STEP_S)) * STEP_S
        duty = levels(rng)
        torque = 2.0 * np.sin(2.0 * np.pi * 1.5 * times)
        gain = 0.06 * np.sin(2.0 * np.pi * 1.53 * times) * duty
        parts.append(Series(0.3 * coloured(rng) + torque + gain, duty, STEP_S, clock))
    found = clock_lines(parts)
    assert all(any(abs(line - near) < 0.003 for line in found) for near in (1.5, 1.53))


def test_noise_alone_seldom_has_a_line() -> None:
    rng = np.random.default_rng(2)
    found = [clock_lines([Series(coloured(rng), levels(rng), STEP_S, 0.0)]) for _ in range(100)]
    assert sum(bool(lines) for lines in found) <= 10


def test_what_follows_a_command_that_repeats_itself_is_no_line_of_the_clock() -> None:
    rng = np.random.default_rng(3)
    times = np.arange(round(SECONDS / STEP_S)) * STEP_S
    sine = 40.0 * np.sin(2.0 * np.pi * 0.5 * times)
    left = coloured(rng) + 4.0 * np.sin(2.0 * np.pi * 1.5 * times)  # the third harmonic, as of friction
    assert not any(abs(f - 1.5) < 0.1 for f in clock_lines([Series(left, sine, STEP_S, 0.0)]))
    assert any(abs(f - 1.5) < 0.1 for f in clock_lines([Series(left, levels(rng), STEP_S, 0.0)]))


def record(model: Model, seed: int) -> Record:
    """A run of a model through an encoder of half a degree."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(12.0 / 0.005)) * 0.005
    duty = np.repeat(rng.choice([-60.0, -30.0, 25.0, 45.0, 70.0], 12), 200)
    bare = make_record(f"run {seed}", times, duty, np.zeros(len(times)), quantum=0.5, at_rest=True)
    y = free_output(bare, Flat.of(model), Start(0.0, 0.0))
    return make_record(f"run {seed}", times, duty, np.floor(y / 0.5) * 0.5 + 0.25, quantum=0.5, at_rest=True)


def test_several_orders_of_one_error_are_scored_together_whatever_their_phases() -> None:
    values = {"level_1_deg": 0.9, "phase_1_deg": 40.0, "level_2_deg": 0.4, "phase_2_deg": 200.0, "level_3_deg": 0.3}
    truth = Model((), LINEAR).with_effect("shaft_angle_error", values)
    runs = WholeRuns([record(truth, seed) for seed in (1, 2, 3)])
    fitted = fit_from_scratch(Model((), LINEAR), runs.records)
    screen = Screen(fitted, runs.records)
    scores = {e.name: screen.score(e) for e in candidates(fitted.model, runs.records, None, screen.span)}
    found = scores["shaft_angle_error"]
    assert max(scores, key=lambda name: scores[name].share) == "shaft_angle_error"
    for key, value in values.items():
        near = 6.0 if key.startswith("phase") else 0.1
        away = float(found.trials[0][key]) - value
        assert abs((away + 180.0) % 360.0 - 180.0 if key.startswith("phase") else away) < near
    assert found.directions[0].basis.shape[1] == 2 * len(effect("shaft_angle_error").couples)


def test_what_lies_beyond_a_parameters_bounds_is_not_tried() -> None:
    """A line of an hour's log that is slower than any ripple; an end of travel, a change beyond all that is known."""
    model = Model.parse("linear+coulomb_friction")
    for name, slow, kept in (
        ("clock_ripple", Span((0.0, 3600.0), (), lines_hz=(0.0047, 1.5)), 2),
        ("hard_stop", Span((0.0, 3600.0), (2e7, 400.0)), 1),
        ("parameter_change", Span((0.0, 3e6), ()), None),
    ):
        trials = effect(name).tried(slow)
        assert kept is None or len(trials) == kept
        for trial in trials:
            model.with_effect(name, trial)
