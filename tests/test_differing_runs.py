"""Runs that differ from each other, and shafts that meet an end, rest and coast under noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from bench_data import QUANTUM_DEG, TICK_S, measure, multisine, steps, truth_model

from fiohost.discover.diagnose import Diagnosis, diagnose_records
from fiohost.discover.logs.offered import span_of
from fiohost.discover.logs.whitened import around_runs, freedom
from fiohost.discover.result import to_json
from fiohost.estimation.fit import fit
from fiohost.estimation.predict import Flat, free_output, turned_deg, windowed
from fiohost.estimation.record import Record, make_record
from fiohost.judging.replica import disturbed_output
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, Start, free_run
from fiohost.motor.state import BRAKE, DRIVE, STANDBY
from fiohost.noise.disturbance import Disturbance
from fiohost.noise.estimate import NONE, Noise
from fiohost.noise.runs import Own, Pull, RunToRun, estimate_runs

GAIN_SD, FRICTION_SD, LOAD_SD_PCT = 0.01, 0.10, 1.0
STOPPED = truth_model(("coulomb_friction", "hard_stop"), {"hard_stop.angle_deg": 700.0})


def differing(seed: int, effect: str | None = None, value: dict[str, float | str] | None = None) -> list[Record]:
    """Four runs to and fro of a motor whose gain, friction and offset load are drawn anew for each."""
    rng = np.random.default_rng(seed)
    records = []
    for k, shape in enumerate((multisine, steps, multisine, steps)):
        own = {
            "linear.gain_deg_s_per_pct": 10.6 * (1.0 + GAIN_SD * rng.standard_normal()),
            "coulomb_friction.level_pct": 3.0 * (1.0 + FRICTION_SD * rng.standard_normal()),
            "constant_load.level_pct": LOAD_SD_PCT * rng.standard_normal(),
        }
        names = ("coulomb_friction", "constant_load", *([effect] if effect else []))
        truth = truth_model(names, {**own, **(value or {})})
        records.append(measure(truth, shape(10.0, rng), rng, name=f"run {k}"))
    return records


@pytest.fixture(scope="module")
def nothing() -> Diagnosis:
    library = ["constant_load", "gravity_load", "gain_warm_up", "direction_dependent_gain", "static_friction"]
    return diagnose_records(differing(1), (), Model.parse("linear+coulomb_friction"), library=library)


@pytest.mark.long("nothing")
def test_how_runs_differ_is_neither_an_effect_nor_noise(nothing: Diagnosis) -> None:
    told = to_json(nothing)
    assert (told["verdict"], told["explained_to"], told["steps"]) == ("no_missing_effect", "repeatability", [])
    assert "constant_load.level_pct" in told["run_to_run"]
    # Offsets that are left over would be taken for a torque of some tenths of a percent that wanders slowly.
    assert told["noise"]["torque_rms_pct"]["value"] < 0.1


def loaded_runs(loads_pct: Sequence[float]) -> list[Record]:
    """Runs of a motor whose gain and friction differ a little, each with its own load."""
    rng, records = np.random.default_rng(11), []
    for k, load_pct in enumerate(loads_pct):
        own = {
            "linear.gain_deg_s_per_pct": 10.6 * (1.0 + 0.5 * GAIN_SD * rng.standard_normal()),
            "coulomb_friction.level_pct": 3.0 * (1.0 + 0.5 * FRICTION_SD * rng.standard_normal()),
            "constant_load.level_pct": load_pct,
        }
        shape = (multisine, steps)[k % 2]
        records.append(measure(truth_model(("coulomb_friction", "constant_load"), own), shape(8.0, rng), rng))
        records[-1] = replace(records[-1], name=f"run {k}")
    return records


@pytest.mark.long
@pytest.mark.parametrize(
    ("loads_pct", "named"),
    [((1.6, 1.25, 1.7), []), ((3.4, 2.6, 3.0, 3.3, 2.9), ["constant_load"])],
)
def test_loads_of_few_runs_have_a_mean_by_chance(loads_pct: Sequence[float], named: list[str]) -> None:
    """One of four benches whose loads scatter about nil has three of one sign; their mean is no effect, nor is what
    looks like it.
    """
    library = ["constant_load", "asymmetric_coulomb_friction", "asymmetric_deadband", "static_friction"]
    found = diagnose_records(loaded_runs(loads_pct), (), Model.parse("linear+coulomb_friction"), library=library)
    assert [s.effect for s in found.steps] == named
    assert (found.verdict, found.explained_to) == ("explained" if named else "no_missing_effect", "repeatability")


@pytest.mark.parametrize(
    ("runs", "level_pct", "chance"), [(3, 1.9, True), (3, 2.1, False), (5, 0.9, True), (5, 1.0, False)]
)
def test_a_common_load_is_told_from_chance_by_how_many_runs_there_are(
    runs: int, level_pct: float, chance: bool
) -> None:
    """The 99 % point of Student's distribution is 9.92 standard errors with three runs, 4.60 with five."""
    own = {f"run {k}": np.zeros(3) for k in range(runs)}
    found = RunToRun(np.array([0.0, 0.0, 0.3]), np.zeros((3, 2)), own, load_error_pct=0.2)
    assert found.load_by_chance(level_pct, 1.0) == chance
    assert not RunToRun(np.zeros(3), np.zeros((3, 2)), own).load_by_chance(level_pct, 1.0)


def test_what_is_a_run_s_own_adds_to_what_it_was_taken_for() -> None:
    """Half a friction more and 1 % of the mean's is 1.51 of it, not 1.515."""
    stairs = np.repeat((20.0, 60.0, 35.0), 500)
    records = [measure(truth_model(), stairs, np.random.default_rng(3), name="run 0")]
    found = fit(truth_model(), records, windows=True, max_iterations=3)
    flat = Flat.of(found.model)
    near, more = np.array([0.01, 0.5, 0.2]), np.array([0.0, 0.01, 0.0])

    def left(own: np.ndarray) -> np.ndarray:
        disturbance = Disturbance(NONE, own=Own.alone(own, len(records[0])))
        return windowed(replace(records[0], disturbance=disturbance), flat, found.starts[0])[0]

    runs = RunToRun(np.zeros(3), np.zeros((3, 2)), {"run 0": near})
    columns, _ = around_runs(found, records, runs)
    changed = left(near) - left(near + more)
    assert np.linalg.norm(changed) > 1.0
    assert np.linalg.norm(columns[0] @ more - changed) < 0.05 * np.linalg.norm(changed)


@pytest.mark.long
def test_what_is_missing_is_named_beside_how_runs_differ() -> None:
    """Of bootstrap samples around the runs' mean, a shaft that stands in one run and creeps in another looks like more
    than any effect.
    """
    records = differing(2, "direction_dependent_gain", {"direction_dependent_gain.ratio": 1.06})
    library = ["direction_dependent_gain", "static_friction", "input_deadband", "constant_load", "gravity_load"]
    found = diagnose_records(records, (), Model.parse("linear+coulomb_friction"), library=library)
    assert found.steps[0].effect == "direction_dependent_gain"
    assert found.verdict == "explained"


def test_a_warmth_that_each_run_has_for_itself_is_not_free() -> None:
    """Five runs of whatever warmth say as much by it as by a gain of each run's own."""
    rng = np.random.default_rng(3)
    records = [measure(truth_model(), np.full(1000, duty), rng, name=f"run {duty}") for duty in (20, 40, 60, 80)]
    windows = [replace(r, disturbance=None) for r in records]
    plain = fit(Model.parse("linear+coulomb_friction"), windows, windows=True)
    values: dict[str, float | str] = {"armature_heating.rise_ratio": 0.3, "armature_heating.time_constant_s": 100.0}
    warms = fit(
        plain.model.with_effect("armature_heating", {k.partition(".")[2]: v for k, v in values.items()}),
        windows,
        windows=True,
    )
    assert freedom(plain, windows) == 0.0
    assert freedom(warms, windows) > len(records)


def stopped(noise_counts: float) -> Record:
    """A shaft driven against its end and back, read by a noisy sensor."""
    rng = np.random.default_rng(6)
    duty = np.repeat((60.0, -40.0, 50.0), (500, 300, 300))
    record = measure(STOPPED, duty, rng)
    noisy = record.y + QUANTUM_DEG * noise_counts * rng.standard_normal(len(record))
    return replace(record, y=np.floor(noisy / QUANTUM_DEG) * QUANTUM_DEG)


@pytest.mark.parametrize("noise_counts", [0.0, 3.0])
def test_an_end_of_travel_is_seen_through_the_noise_of_the_sensor(noise_counts: float) -> None:
    record = stopped(noise_counts)
    ends = span_of([record]).ends_deg
    assert min(abs(end - 700.0) for end in ends) < 2.0
    # The shaft was never beyond the end, wherever noise put its readings.
    assert turned_deg(record, Flat.of(STOPPED)) == 0.0
    # An estimate some degrees short of where it stood does not send the end to the turn before.
    assert turned_deg(record, Flat.of(STOPPED.with_values({"hard_stop.angle_deg": 697.0}))) == 0.0


def test_a_random_torque_does_not_push_a_coasting_shaft_through_its_end() -> None:
    times = np.arange(2000) * TICK_S
    modes = np.where(np.arange(2001) % 400 < 150, 1, STANDBY)
    excitation = Excitation(times, times + TICK_S, np.where(modes == 1, 60.0, 0.0), modes)
    angle = free_run(STOPPED, excitation, 0.0)
    record = make_record("coasts", times, np.zeros(2000), angle, quantum=QUANTUM_DEG, at_rest=True)
    record = replace(record, excitation=excitation)
    noise = Noise(NONE.sensor, replace(NONE.torque_pct, value=2.0), replace(NONE.torque_s, value=0.5), 0.0, 0)
    rng, start = np.random.default_rng(8), Start(0.0, 0.0)
    drawn = [disturbed_output(record, STOPPED, start, noise, rng) for _ in range(20)]
    assert max(y.max() for y in drawn) <= 700.0 + 1e-6
    assert min(np.ptp([y[i] for y in drawn]) for i in (100, 390)) > 1.0  # driven, and coasting
    quiet = replace(noise, torque_pct=replace(NONE.torque_pct, value=1e-12))
    same = disturbed_output(record, STOPPED, start, quiet, rng)
    assert same == pytest.approx(free_output(record, Flat.of(STOPPED), start), abs=1e-6)


@pytest.mark.parametrize("name", ["coast_pwm", "fast_decay", "input_deadband", "armature_inductance", "backlash"])
def test_a_random_torque_is_a_load_whatever_the_bridge_makes_of_a_duty(name: str) -> None:
    model = truth_model(("coulomb_friction", name))
    times = np.arange(1200) * TICK_S
    modes = np.where(np.arange(1201) % 300 < 200, DRIVE, BRAKE)
    duties = np.where(modes == DRIVE, np.where(np.arange(1201) % 600 < 300, 35.0, -20.0), 0.0)
    record = make_record("braked", times, np.zeros(1200), np.zeros(1200), quantum=QUANTUM_DEG, at_rest=True)
    record = replace(record, excitation=Excitation(times, times + TICK_S, duties, modes))
    quiet = Noise(NONE.sensor, replace(NONE.torque_pct, value=1e-9), replace(NONE.torque_s, value=0.5), 0.0, 0)
    rng, start = np.random.default_rng(3), Start(0.0, 0.0)
    alone = free_output(record, Flat.of(model), start)
    assert disturbed_output(record, model, start, quiet, rng) == pytest.approx(alone, abs=2e-3)
    # A steady torque is a load of that size.
    steady = replace(quiet, torque_pct=replace(NONE.torque_pct, value=3.0), torque_s=replace(NONE.torque_s, value=1e9))
    loaded = model.with_effect("constant_load", {"level_pct": -3.0 * np.random.default_rng(4).standard_normal()})
    drawn = disturbed_output(record, model, start, steady, np.random.default_rng(4))
    assert drawn == pytest.approx(free_output(record, Flat.of(loaded), start), abs=2e-2)


def test_of_three_runs_a_scatter_is_drawn_as_wide_as_they_leave_it_open() -> None:
    """A deviation over the scatter found is Student's of two degrees of freedom: 4.3 where a normal has 1.96."""
    rng = np.random.default_rng(9)
    few = RunToRun(np.ones(3), np.zeros((3, 2)), {f"run {k}": np.zeros(3) for k in range(3)})
    drawn = np.array([few.likely_sd(rng) * rng.standard_normal(3) for _ in range(20000)])
    assert np.quantile(np.abs(drawn), 0.95) == pytest.approx(4.30, rel=0.05)


def test_an_offset_that_all_runs_share_is_another_day_s_but_none_of_chance() -> None:
    """Were it in the null too, dry friction of runs that go one way could not be told from how they differ."""
    alike = RunToRun(
        np.array([0.0, 0.0, 0.2]), np.zeros((3, 2)), {f"run {k}": np.array([0.0, 0.0, 1.5]) for k in range(9)}
    )
    assert alike.about_model[2] == pytest.approx(1.5)
    rng = np.random.default_rng(1)
    assert np.median([alike.likely_sd(rng)[2] for _ in range(200)]) == pytest.approx(0.2, rel=0.2)


def pulls_of(loads: np.ndarray, rng: np.random.Generator) -> dict[str, Pull]:
    """Of runs with loads of their own, each known to some tenths of a percent beside its gain and its friction."""
    found = {}
    for k, load in enumerate(loads):
        rows = rng.standard_normal((40, 3)) * (300.0, 30.0, 6.0)
        information = rows.T @ rows
        heard = np.linalg.solve(np.linalg.cholesky(information).T, rng.standard_normal(3))
        found[f"run {k}"] = Pull(information, information @ (np.array([0.0, 0.0, load]) + heard))
    return found


def test_a_load_that_runs_have_in_common_is_told_from_how_they_scatter() -> None:
    """Of 3,000 sets of three to eight runs without one, 3 looked so at this chance of 1 in 1000."""
    rng = np.random.default_rng(3)
    for mean_pct, least, most in ((0.0, 0, 1), (2.0, 38, 40)):
        sets = [pulls_of(mean_pct + 0.4 * rng.standard_normal(8), rng) for _ in range(40)]
        assert least <= sum(estimate_runs(pulls).shares_load(1e-3) for pulls in sets) <= most


@pytest.mark.long
def test_what_an_effect_takes_is_seen_beside_how_runs_differ() -> None:
    """Windows as they are have one model for all runs, whose offsets rule them: they err no less with it."""
    records = differing(8, "bridge_voltage_drop", {"bridge_voltage_drop.drop_pct": 0.2})
    found = diagnose_records(records, (), Model.parse("linear+coulomb_friction"), library=["bridge_voltage_drop"])
    told = ([s.effect for s in found.steps], found.verdict, found.explained_to)
    assert told == (["bridge_voltage_drop"], "explained", "repeatability")


@pytest.mark.long
def test_a_load_that_all_runs_have_in_common_is_not_how_they_differ() -> None:
    """A library without it has nothing else that would take it, and loads of the runs' own do."""
    rng = np.random.default_rng(2)
    truths = (
        truth_model(("coulomb_friction", "constant_load"), {"constant_load.level_pct": 1.5 + 0.05 * k})
        for k in range(4)
    )
    records = [measure(truth, multisine(8.0, rng), rng, name=f"run {k}") for k, truth in enumerate(truths)]
    found = diagnose_records(records, (), Model.parse("linear+coulomb_friction"), library=())
    assert (found.verdict, found.ruling) == ("unexplained", ("shared_load",))
