"""Logs of speed: a mean speed is a difference of counts, and a window within a run begins in the interval before."""

from __future__ import annotations

import numpy as np
import pytest
from bench_data import measure, multisine, truth_model

from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import MEAN_SPEED, Record, make_record
from fiohost.judging.followed import dependences
from fiohost.judging.metrics import judge
from fiohost.judging.replica import Replicas
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start

TICK_S = 0.02
QUANTUM = 6.0


@pytest.fixture(scope="module")
def truth() -> Model:
    return truth_model()


@pytest.fixture(scope="module")
def speeds(truth: Model) -> Record:
    """Mean speeds of a motor between ticks, without counts: what the model says is the truth."""
    rng = np.random.default_rng(5)
    made = measure(truth, multisine(10.0, rng), rng)
    every = make_record(
        "speed", made.excitation.times_s[::4], made.excitation.duties_pct[1::4], np.ones(len(made.y[::4])),
        kind=MEAN_SPEED, unit="deg/s", quantum=QUANTUM, at_rest=True,
    )  # fmt: skip
    exact = free_output(every, Flat.of(truth), Start(0.0, 0.0))
    return make_record(
        "speed", every.excitation.times_s, every.excitation.duties_pct[1:], exact, kind=MEAN_SPEED, unit="deg/s",
        quantum=QUANTUM, at_rest=True,
    )  # fmt: skip


def test_counts_of_a_mean_speed_err_like_the_difference_of_two_readings(truth: Model, speeds: Record) -> None:
    errors = Replicas(speeds, truth, Start(0.0, 0.0)).draw(np.random.default_rng(1)) - speeds.y
    assert np.std(errors) == pytest.approx(QUANTUM / np.sqrt(6.0), rel=0.15)
    assert np.max(np.abs(np.cumsum(errors))) <= 1.01 * QUANTUM, "counts do not get lost"
    assert np.corrcoef(errors[:-1], errors[1:])[0, 1] < -0.3


def test_the_true_model_has_no_error_in_windows_of_mean_speeds(truth: Model, speeds: Record) -> None:
    errors = judge(speeds, truth).errors
    assert errors.free_run_rms < 1e-6
    assert errors.window_rms < 1e-3


def test_what_a_speed_log_lacks_is_traced_to_what_it_follows(truth: Model, speeds: Record) -> None:
    less = truth.with_values({"coulomb_friction.level_pct": 0.0})
    found = dependences([speeds], less, [judge(speeds, less)], np.random.default_rng(2))
    assert "speed_sign" in [d.variable for d in found if d.significant]
