"""Logs of speed: a mean speed is a difference of counts, and a window within a run begins in the interval before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench_data import measure, multisine, steps, suite, truth_model

from fiohost.discover.diagnose import diagnose_records
from fiohost.discover.logs.whitened import drawing, movements, noise_of, plain, with_noise
from fiohost.discover.result import to_json
from fiohost.estimation.fit import fit
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import MEAN_SPEED, Record, make_record, thinned
from fiohost.judging.followed import dependences
from fiohost.judging.metrics import judge
from fiohost.judging.replica import Replicas
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.draw import draw_sensor
from fiohost.noise.estimate import NONE, Ranged
from fiohost.report.words import verdict_sentence

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


def test_speeds_from_an_angle_that_is_noisy_are_explained_to_that_noise() -> None:
    """Differences of noisy readings are not white: taken for noise of the speed, they stayed unexplained."""
    rng, speeds = np.random.default_rng(6), []
    for record in suite(truth_model(), 2):
        shaky = record.y + record.quantum * np.round(rng.standard_normal(len(record)))
        y = np.diff(shaky, prepend=shaky[0]) / record.sample_time_s
        quantum = record.quantum / record.sample_time_s
        speeds.append(replace(record, y=y, kind=MEAN_SPEED, quantum=quantum, unit="deg/s", weights=np.ones(len(y))))
    library = ["quadratic_drag", "viscous_friction", "cogging_torque", "input_deadband"]
    told = to_json(diagnose_records(speeds, [], Model.parse("linear+coulomb_friction"), library=library))
    assert (told["verdict"], told["explained_to"]) == ("no_missing_effect", "noise")
    assert told["noise"]["sensor_of_angle"]
    assert "noise of the angle that speeds are taken from, of " in verdict_sentence(told)


@pytest.mark.parametrize("of_angle", [False, True])
def test_bootstrap_samples_of_fast_speeds_err_as_each_of_these_does(of_angle: bool) -> None:
    """Windows take the means of five readings of a millisecond: their noise was taken for that of each, and
    benches of 1 kHz with noise stayed unexplained.
    """
    rng, truth, step_s = np.random.default_rng(7), truth_model(), 0.001
    times, duty_pct = np.arange(8000) * step_s, np.repeat(steps(8.0, rng), 5)
    fast = make_record("fast", times, duty_pct, np.ones(8000), kind=MEAN_SPEED, unit="deg/s", at_rest=True)
    exact = free_output(fast, Flat.of(truth), Start(0.0, 0.0))
    sensor = replace(NONE, sensor=Ranged(60.0, 60.0, 60.0), of_angle=of_angle)
    fast = replace(fast, y=exact + draw_sensor(8000, sensor, rng), weights=np.ones(8000))
    few = plain([thinned(fast, 0.005)])
    found = fit(truth, few, windows=True)
    noise = noise_of(found.model, found.starts, few)
    assert noise.of_angle is of_angle
    (drawn,) = drawing([fast], noise)
    assert drawn.disturbance is not None
    assert drawn.disturbance.noise.sensor.value == pytest.approx(60.0, rel=0.1)
    errors = Replicas(drawn, truth, Start(0.0, 0.0)).draw(rng) - exact
    assert np.std(errors) == pytest.approx(60.0, rel=0.1)
    own = with_noise(few, truth, noise, movements(few, truth, found.starts))[0].disturbance
    assert own is not None
    assert own.noise.sensor.value == pytest.approx(noise.sensor.value)


def test_the_true_model_has_no_error_in_windows_of_mean_speeds(truth: Model, speeds: Record) -> None:
    errors = judge(speeds, truth).errors
    assert errors.free_run_rms < 1e-6
    assert errors.window_rms < 1e-3


def test_what_a_speed_log_lacks_is_traced_to_what_it_follows(truth: Model, speeds: Record) -> None:
    less = truth.with_values({"coulomb_friction.level_pct": 0.0})
    found = dependences([speeds], less, [judge(speeds, less)], np.random.default_rng(2))
    assert "speed_sign" in [d.variable for d in found if d.significant]
