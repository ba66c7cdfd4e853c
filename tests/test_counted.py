"""Mean speeds that were taken from counts are searched as the angle that they add up to, and told as speeds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench_data import suite, truth_model

from fiohost.discover.diagnose import Diagnosis, diagnose_records
from fiohost.discover.result import to_json
from fiohost.estimation.counted import as_counts, odds_of_counts
from fiohost.estimation.record import ANGLE, MEAN_SPEED, Record
from fiohost.motor.model import Model
from fiohost.noise.draw import draw_sensor
from fiohost.noise.estimate import Noise, Ranged
from fiohost.report.outlook import curves_sentence
from fiohost.report.words import searched_unit, verdict_sentence

DECLARED = Model.parse("linear+coulomb_friction")
SMALL = truth_model(("coulomb_friction", "bridge_voltage_drop"), {"bridge_voltage_drop.drop_pct": 0.5})


def speeds_of(record: Record, digits: int = 9, quantum: float | None = None) -> Record:
    """What a logger writes that differs its counter, of a record that begins at rest."""
    y = np.round(np.diff(record.y, prepend=record.y[0]) / record.sample_time_s, digits)
    step = record.quantum / record.sample_time_s if quantum is None else quantum
    return replace(record, y=y, kind=MEAN_SPEED, quantum=step, unit="deg/s", own_zero=True, weights=np.ones(len(y)))


def rounded_speeds_of(record: Record, rng: np.random.Generator, noise: float) -> Record:
    """What a logger writes that measures the speed and rounds it to 6 deg/s."""
    smooth = np.gradient(np.convolve(record.y, np.ones(9) / 9.0, "same"), record.excitation.times_s)
    y = 6.0 * np.round((smooth + noise * rng.standard_normal(len(smooth))) / 6.0)
    return replace(speeds_of(record), y=y, quantum=6.0)


@pytest.fixture(scope="module")
def angles() -> list[Record]:
    return suite(truth_model(), 3)


@pytest.mark.parametrize(("digits", "quantum"), [(9, None), (1, None), (9, 0.0), (9, 99.0)])
def test_speeds_of_counts_are_their_angle_again(angles: list[Record], digits: int, quantum: float | None) -> None:
    """Whatever their digits, and though the step of the counts was not said, or roughly."""
    counted = as_counts([speeds_of(r, digits, quantum) for r in angles], DECLARED)
    assert counted is not None
    for angle, found in zip(angles, counted, strict=True):
        np.testing.assert_allclose(found.y, angle.y - angle.y[0], atol=1e-6 * float(np.ptp(angle.y)))
        assert (found.kind, found.unit, found.quantum) == (ANGLE, "deg", pytest.approx(angle.quantum, rel=1e-6))
        np.testing.assert_allclose(found.weights, angle.weights)
        assert found.at_rest == (np.ptp(angle.y[:5]) == 0.0)


def test_counts_that_shake_are_counts(angles: list[Record]) -> None:
    rng = np.random.default_rng(1)
    shaken = [replace(r, y=r.y + r.quantum * np.round(rng.standard_normal(len(r)))) for r in angles]
    assert as_counts([speeds_of(r) for r in shaken], DECLARED) is not None


@pytest.mark.parametrize("noise", [0.0, 2.0, 6.0, 20.0])
def test_speeds_that_were_measured_and_rounded_add_up_to_nothing(angles: list[Record], noise: float) -> None:
    rng = np.random.default_rng(2)
    assert as_counts([rounded_speeds_of(r, rng, noise) for r in angles], DECLARED) is None


def test_what_is_no_whole_log_of_a_shaft_s_counts_stays_as_it_is(angles: list[Record]) -> None:
    speeds = [speeds_of(r) for r in angles]
    broken = replace(speeds[0], segments=np.repeat([0, 1], [1000, len(speeds[0]) - 1000]))
    fine = replace(speeds[0], y=speeds[0].y + np.pi * np.arange(len(angles[0])) ** 0.5, quantum=1e-300)
    others = (broken, replace(speeds[0], rotary=False), replace(speeds[0], noise_rms=2.0), fine, angles[0])
    assert as_counts(speeds[:1], DECLARED) is not None
    for other in others:
        assert as_counts([speeds[1], other], DECLARED) is None


def test_the_odds_tell_differences_from_errors_of_each_reading() -> None:
    rng = np.random.default_rng(3)
    white = rng.standard_normal(4001)
    assert odds_of_counts(np.diff(white)) > 100.0
    assert odds_of_counts(white) < -100.0
    assert odds_of_counts(np.zeros(100)) == 0.0
    assert odds_of_counts(white[:10]) == 0.0


def test_the_noise_of_an_angle_as_mean_speeds_have_it() -> None:
    none = Ranged(0.0, 0.0, 0.0)
    noise = Noise(Ranged(0.2, 0.1, 0.3), none, none, likely=np.array([[0.2, 0.0, 0.0]]))
    told = noise.of_speeds(0.02)
    rng = np.random.default_rng(4)
    read = 0.2 * rng.standard_normal(100_001)
    assert told.sensor.value == pytest.approx(float(np.std(np.diff(read) / 0.02)), rel=0.02)
    assert float(np.std(draw_sensor(100_000, told, rng))) == pytest.approx(told.sensor.value, rel=0.02)
    assert told.likely is not None
    assert told.likely[0, 0] == pytest.approx(told.sensor.value)


@pytest.fixture(scope="module")
def small() -> Diagnosis:
    logs = [speeds_of(r) for r in suite(SMALL, 5)]
    library = ["bridge_voltage_drop", "viscous_friction", "supply_sag", "backlash"]
    return diagnose_records(logs[:3], logs[3:], DECLARED, library=library)


@pytest.mark.long("small")
def test_an_effect_far_below_one_count_of_speed_is_named(small: Diagnosis) -> None:
    """Each speed weighed by itself, nothing seemed missing: 41 deg/s of counts hid all of it."""
    assert [s.effect for s in small.steps] == ["bridge_voltage_drop"]
    assert small.final.fit.model.number("bridge_voltage_drop.drop_pct") == pytest.approx(0.5, rel=0.1)
    assert (small.verdict, small.explained_to) == ("explained", "sensor")


@pytest.mark.long("small")
def test_what_was_searched_as_an_angle_is_told_in_speeds(small: Diagnosis) -> None:
    told = to_json(small)
    assert told["output_unit"] == "deg/s"
    searched = told["searched_as"]
    assert (searched["unit"], [r.unit for r in small.train]) == ("deg", ["deg"] * 3)
    assert searched["after"]["free_run_rms"] < 1.1 * searched["floor"]["free_run_rms"] < 0.2  # half a degree a count
    assert searched["before"]["free_run_rms"] > 1.5 * searched["floor"]["free_run_rms"]
    assert told["explained_pct"] > 95.0
    assert f"{searched['after']['free_run_rms']:.3f} deg after" in verdict_sentence(told)
    assert told["noise"]["sensor_rms"]["unit"] == "deg/s"
    for role in ("train", "holdout"):
        after, floor = told["after"][role]["window_rms"], told["floor"][role]["window_rms"]
        assert 20.0 < floor < 60.0  # half a degree every 5 ms is 100 deg/s
        assert after == pytest.approx(floor, rel=0.05)
    for log in told["logs"]:
        assert log["after"]["window_rms"] == pytest.approx(log["floor"]["window_rms"], rel=0.1)
    assert told["steps"][0]["after"]["train"] == told["after"]["train"]


@pytest.mark.long("small")
def test_what_was_found_of_the_angle_is_told_in_its_unit(small: Diagnosis) -> None:
    told = to_json(small)
    assert searched_unit(told) == "deg"
    assert searched_unit({**told, "searched_as": None}) == "deg/s"
    curves = {"effects": ["load_over_speed"], "before": {"window_rms": 0.5}, "after": {"window_rms": 0.2}}
    assert "err by 0.200 deg with them, 0.500 deg without" in curves_sentence({**told, "unnamed": curves})
