"""Speeds that a logger counted and then smoothed: the average is found in the readings, and counts told as counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench_data import measure
from test_speed_filter import GAIN, TICK_S, TRUTH, duties, model

from fiohost.bench.log import Log
from fiohost.checks.kinematics import check
from fiohost.checks.said import Said
from fiohost.discover.diagnose import diagnose_records
from fiohost.discover.logs.whitened import noise_of
from fiohost.discover.result import to_json
from fiohost.estimation.bench import joining, with_bench
from fiohost.estimation.fit import fit
from fiohost.estimation.record import SPEED, Record, make_record, record_from_log, thinned
from fiohost.judging.replica import Replicas
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, free_run
from fiohost.noise.average import Average, found_average
from fiohost.noise.quantum import found_quantum

COUNT, KEEPS, DIGITS = 18.0, 0.8, 3
FILTERED = Average(KEEPS, COUNT)
LAG_S = -TICK_S / float(np.log(KEEPS))


def counted(duty: np.ndarray, truth: Model, seed: int) -> np.ndarray:
    """Speeds (n) in deg/s of a motor that begins at rest, from the counts of each interval."""
    times = np.arange(len(duty)) * TICK_S
    excitation = Excitation(
        times, times, np.concatenate(([0.0], duty)), np.concatenate(([2], np.ones(len(duty), dtype=np.int64)))
    )
    angle = free_run(truth, excitation, np.random.default_rng(seed).uniform(0.0, COUNT * TICK_S))
    counts = np.floor(angle / (COUNT * TICK_S))
    return np.asarray(np.diff(counts, prepend=counts[0]) * COUNT)


def smoothed(speed: np.ndarray, keeps: float = KEEPS) -> np.ndarray:
    shown = [0.0]
    for value in speed[1:]:
        shown.append(keeps * shown[-1] + (1.0 - keeps) * value)
    return np.round(shown, DIGITS)


def logged(seed: int, truth: Model, seconds: float = 10.0) -> Record:
    """A log of smoothed speeds, as ``record_from_log`` would have it."""
    duty = duties(seconds, np.random.default_rng(seed))
    y = smoothed(counted(duty, truth, seed))
    times = np.arange(len(duty)) * TICK_S
    step = found_quantum(y)
    record = make_record(f"log {seed}", times, duty, y, kind=SPEED, unit="deg/s", quantum=step, at_rest=True)
    return replace(record, average=found_average(y, duty, step))


@pytest.mark.parametrize(("keeps", "count"), [(0.8, 18.0), (0.5, 36.0), (0.95, 9.0)])
def test_the_average_and_the_counts_before_it_are_found_in_the_readings(keeps: float, count: float) -> None:
    duty = duties(12.0, np.random.default_rng(1))
    found = found_average(smoothed(counted(duty, model(None), 1) * count / COUNT, keeps), duty, 10.0**-DIGITS)
    assert found is not None
    assert (found.keeps, found.quantum) == (pytest.approx(keeps, abs=2e-4), pytest.approx(count, rel=2e-3))


def test_nothing_else_is_taken_for_an_average_of_counts() -> None:
    rng = np.random.default_rng(2)
    duty = duties(12.0, rng)
    speed = counted(duty, model(None), 2)
    analogue = smoothed(speed + rng.normal(0.0, 5.0, len(speed)))
    for other in (speed, analogue, smoothed(speed) + rng.normal(0.0, 1.0, len(speed))):
        assert found_average(other, duty, found_quantum(other)) is None
    assert found_average(speed[:30], duty[:30], COUNT) is None
    assert found_average(np.zeros(500), np.zeros(500), 0.0) is None


@pytest.mark.parametrize("late_rows", [1, 4])
def test_a_motor_of_one_lag_is_no_average_of_its_two_levels(late_rows: int) -> None:
    """What it was driven with differs by the levels' difference, wherever it was switched."""
    rng = np.random.default_rng(3)
    level = np.repeat(rng.choice((20.0, 60.0), 400), rng.integers(4, 20, 400))
    shown = smoothed(GAIN * np.concatenate((np.zeros(late_rows), level))[: len(level)], 0.7)
    assert found_average(shown, np.full(len(level), 40.0), 0.0) is not None
    assert found_average(shown, level, 0.0) is None


def test_an_average_is_undone_but_where_windows_begin() -> None:
    speed = np.random.default_rng(3).integers(-40, 40, 300) * COUNT
    shown = FILTERED.of(speed, 5.0)
    undone = FILTERED.undone(shown, np.array([0, 100]))
    assert undone[[0, 100]] == pytest.approx(shown[[0, 100]])
    kept = np.setdiff1d(np.arange(300), (0, 100))
    assert undone[kept] == pytest.approx(speed[kept])
    assert FILTERED.undone(np.column_stack((shown, shown)), np.array([0, 100]))[:, 1] == pytest.approx(undone)
    assert np.std(FILTERED.of(np.diff(np.random.default_rng(4).uniform(0.0, COUNT, 100_000)), 0.0)) == pytest.approx(
        FILTERED.rms, rel=0.02
    )


def test_counts_that_are_smoothed_are_no_noise() -> None:
    """Taken for what it shows, such a speed has noise of a degree a second that is not white."""
    records = [logged(seed, model(LAG_S)) for seed in (5, 6)]
    assert [r.average for r in records] == [FILTERED, FILTERED]
    # Counted means of the shaft's own speed, smoothed: the model's filter does that to it.
    records = [logged(seed, model(None)) for seed in (5, 6)]
    found = fit(model(LAG_S), records, windows=True)
    sensor = noise_of(found.model, found.starts, records).sensor
    assert sensor.low == 0.0
    assert sensor.value < 1.0
    plain = [replace(r, average=None) for r in records]
    assert noise_of(found.model, found.starts, plain).sensor.low > 0.8


def test_bootstrap_samples_are_counted_and_smoothed_too() -> None:
    record = logged(7, model(None))
    replicas = Replicas(record, model(LAG_S), fit(model(LAG_S), [record], windows=True).starts[0])
    drawn = replicas.draw(np.random.default_rng(8))
    assert found_average(drawn, record.acting_pct, record.quantum) == record.average
    assert np.std(drawn - replicas.truth) == pytest.approx(FILTERED.rms, rel=0.15)


def test_a_bench_has_the_average_that_one_log_shows_and_all_have() -> None:
    one, two = logged(9, model(None)), logged(10, model(None))
    unseen = replace(two, average=None)
    assert [r.average for r in with_bench([one, unseen])] == [FILTERED, FILTERED]
    assert [r.average for r in with_bench([unseen, unseen])] == [None, None]
    other = replace(unseen, y=unseen.y + np.random.default_rng(1).normal(0.0, 1.0, len(unseen)))
    assert [r.average for r in with_bench([one, other])] == [None, None]
    assert [r.average for r in joining([unseen], [one, two])] == [FILTERED]


def test_of_every_third_reading_the_average_forgets_more_and_counts_are_finer() -> None:
    record, lag_s = logged(16, model(None), 30.0), model(LAG_S)
    third = thinned(record, 3.0 * TICK_S)
    assert third.average == Average(pytest.approx(KEEPS**3), pytest.approx(COUNT / 3.0))
    found = fit(lag_s, [third], windows=True)
    sensor = noise_of(found.model, found.starts, [third]).sensor
    assert sensor.low == 0.0
    assert noise_of(found.model, found.starts, [replace(third, average=None)]).sensor.low > 0.8


def test_the_average_is_told_before_anything_is_fitted() -> None:
    findings, _ = check([logged(11, model(None))], [Said()])
    (told,) = [f for f in findings if f.name == "average_found"]
    assert not told.harm
    assert "keeps 0.8 of the one before" in told.advice
    assert "steps of 18 deg/s" in told.advice


@pytest.mark.long
def test_beside_a_filter_of_counts_nothing_is_left_to_explain() -> None:
    drag = {**TRUTH, "quadratic_drag.pct_at_1000_deg_s": 30.0}
    logs = [logged(seed, Model(("coulomb_friction", "quadratic_drag"), drag)) for seed in (12, 13, 14)]
    library = ["speed_filter", "quadratic_drag", "transport_delay", "constant_load"]
    told = to_json(diagnose_records(logs, [], Model.parse("linear+coulomb_friction"), library=library))
    assert {s["effect"] for s in told["steps"]} == {"speed_filter", "quadratic_drag"}
    assert (told["verdict"], told["residual"]["white"]) == ("explained", True)
    assert told["final"]["parameters"]["linear.gain_deg_s_per_pct"]["value"] == pytest.approx(GAIN, rel=0.01)


def test_a_log_of_angles_has_none() -> None:
    rng = np.random.default_rng(15)
    assert measure(model(None), duties(3.0, rng), rng).average is None
    columns = {"time_s": np.arange(400) * TICK_S, "duty_pct": np.full(400, 20.0)}
    columns["speed_deg_s"] = smoothed(counted(duties(4.2, rng)[:400], model(None), 15))
    assert record_from_log(Log.from_columns(columns, {})).average == FILTERED
