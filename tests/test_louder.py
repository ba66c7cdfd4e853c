"""A sensor may be louder in one run than in the next: each has its own noise where more than chance says so."""

from __future__ import annotations

import numpy as np
import pytest
from test_noise import STEP_S, drawn
from test_speed_filter import LOOP_S, TICK_S, duties, model, speeds

from fiohost.discover.diagnose import diagnose_records
from fiohost.discover.logs.whitened import drawing, with_noise
from fiohost.discover.result import to_json
from fiohost.estimation.record import SPEED, Record, make_record
from fiohost.motor.model import Model
from fiohost.noise import covariance
from fiohost.noise.estimate import Noise, Ranged, estimate
from fiohost.noise.likelihood import Group, Motor, pieces
from fiohost.report.words import verdict_sentence

SPEED_NOISE = {"slow.csv": 1.0, "middle.csv": 2.0, "fast.csv": 3.0}


def of_runs(rng: np.random.Generator, motor: Motor, noises: dict[str, float], torque_pct: float) -> list[Group]:
    """Pieces of runs whose sensors have such noise."""
    found = []
    for run, noise in noises.items():
        found += pieces(*drawn(rng, motor, noise, torque_pct, 0.2), motor, run)
    return found


@pytest.mark.parametrize(
    ("motor", "torque_pct"),
    [
        (Motor(10.0, 0.08, covariance.SPEED, 0.0, STEP_S), 0.5),
        (Motor(10.0, 0.08, covariance.ANGLE, 0.5, STEP_S), 0.0),
        (Motor(10.0, 0.08, covariance.MEAN_SPEED, 6.0, 4.0 * STEP_S), 0.0),
    ],
)
def test_how_loud_each_run_is_is_found(motor: Motor, torque_pct: float) -> None:
    rng = np.random.default_rng(1)
    noises = {run: 2.0 * size for run, size in SPEED_NOISE.items()}
    found = estimate(of_runs(rng, motor, noises, torque_pct))
    assert {run: found.of(run).sensor.value for run in noises} == pytest.approx(noises, rel=0.06)
    assert found.of("fast.csv").sensor.low <= 6.0 <= found.of("fast.csv").sensor.high * 1.03
    assert found.torque_pct.low <= torque_pct <= found.torque_pct.high


@pytest.mark.long
def test_runs_that_are_alike_share_one_noise() -> None:
    rng, alone = np.random.default_rng(2), 0
    for kind, quantum in ((covariance.SPEED, 0.0), (covariance.ANGLE, 0.5)):
        for _ in range(20):
            motor = Motor(rng.uniform(6.0, 16.0), rng.uniform(0.04, 0.15), kind, quantum, STEP_S)
            groups = of_runs(rng, motor, dict.fromkeys("abcd", 1.0), float(rng.choice((0.0, 0.5))))
            alone += bool(estimate(groups).louder)
    assert alone <= 1


def test_beside_counts_that_err_more_runs_share_one_noise() -> None:
    motor = Motor(10.0, 0.08, covariance.MEAN_SPEED, 24.0, 4.0 * STEP_S)
    noises = {run: 2.0 * size for run, size in SPEED_NOISE.items()}
    found = estimate(of_runs(np.random.default_rng(4), motor, noises, 0.0))
    assert 0.0 < found.sensor.low < motor.count_rms == pytest.approx(24.0 / np.sqrt(6.0))
    assert found.louder == {}


def test_declared_noise_is_that_of_every_run() -> None:
    motor = Motor(10.0, 0.08, covariance.SPEED, 0.0, STEP_S)
    assert estimate(of_runs(np.random.default_rng(3), motor, SPEED_NOISE, 0.0), sensor=2.0).louder == {}


def test_a_run_that_was_not_looked_at_may_be_as_loud_as_any() -> None:
    sure = Ranged(2.0, 1.9, 2.1)
    noise = Noise(sure, sure, sure, louder={"a": 0.5, "b": 3.0}, likely=np.array([[2.0, 1.0, 0.1]]))
    assert noise.of("b").sensor == Ranged(6.0, pytest.approx(5.7), pytest.approx(6.3))
    assert noise.of("b").drawn(0.9).sensor.value == pytest.approx(6.0)
    other = noise.of("c")
    assert other.sensor == sure
    assert [other.drawn(u).sensor.value for u in (0.0, 0.9)] == pytest.approx([1.0, 6.0])


def analogue(name: str, noise: float, seed: int, reach: float) -> Record:
    """A log of an analogue speed of a motor that begins at rest, simulated by Euler's rule."""
    rng = np.random.default_rng(seed)
    duty = reach * duties(12.0, rng)
    times = np.arange(len(duty)) * TICK_S
    y = speeds(duty)[:: round(TICK_S / LOOP_S)] + noise * rng.standard_normal(len(duty))
    return make_record(name, times, duty, y, kind=SPEED, unit="deg/s", command_delay_s=0.0)


def test_records_are_whitened_and_drawn_with_the_noise_of_their_own_run() -> None:
    records = [analogue(name, noise, seed, 1.0) for seed, (name, noise) in enumerate(SPEED_NOISE.items())]
    sure, none = Ranged(2.0, 2.0, 2.0), Ranged(0.0, 0.0, 0.0)
    noise = Noise(sure, none, none, louder={name: size / 2.0 for name, size in SPEED_NOISE.items()})
    moving = [covariance.Movement.steady(len(r.y), 0.1) for r in records]
    for found in (with_noise(records, model(None), noise, moving), drawing(records, noise)):
        of_its_own = [r.disturbance.noise.sensor.value for r in found if r.disturbance is not None]
        assert of_its_own == pytest.approx(list(SPEED_NOISE.values()))
    weights = [
        float(np.median(r.disturbance.whitener.sure))
        for r in with_noise(records, model(None), noise, moving)
        if r.disturbance is not None and r.disturbance.whitener is not None
    ]
    assert weights[0] / weights[2] == pytest.approx(9.0, rel=0.2)


@pytest.mark.long
def test_a_motor_that_lacks_nothing_is_explained_though_its_sensor_is_louder_where_it_is_faster() -> None:
    reach = (0.3, 0.6, 1.0)
    logs = [analogue(name, 10.0 * noise, 10 + k, reach[k]) for k, (name, noise) in enumerate(SPEED_NOISE.items())]
    library = ["constant_load", "transport_delay", "viscous_friction_by_direction"]
    found = diagnose_records(logs, [], Model.parse("linear+coulomb_friction"), library=library)
    told = to_json(found)
    assert (told["verdict"], told["explained_to"], told["steps"]) == ("no_missing_effect", "noise", [])
    own = {name: 10.0 * noise for name, noise in SPEED_NOISE.items()}
    assert told["noise"]["sensor_by_log"] == pytest.approx(own, rel=0.15)
    assert " by log)" in verdict_sentence(told)
