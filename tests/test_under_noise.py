"""Noise and what is missing, mistaken for each other: what windows as they are say, and what runs scatter by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench_data import measure, steps, suite, truth_model

from fiohost.discover.diagnose import Diagnosis, diagnose_records
from fiohost.discover.logs.job import Job
from fiohost.discover.logs.movement import at_rest, movement, standing
from fiohost.discover.logs.optimise import again
from fiohost.discover.logs.refit import LogsBeside, ranked
from fiohost.discover.logs.rough import rough_fits
from fiohost.discover.logs.weighed_windows import WeighedWindows
from fiohost.discover.logs.whitened import with_noise
from fiohost.discover.result import to_json
from fiohost.discover.settings import SETTINGS
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.intervals import estimates
from fiohost.estimation.predict import Flat, free_output, windowed
from fiohost.estimation.record import Record, make_record
from fiohost.judging.floor import refitted_models
from fiohost.judging.replica import disturbed_output
from fiohost.motor.effect import effect
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.estimate import Noise, Ranged
from fiohost.noise.runs import RunToRun

STEP_S, QUANTUM_DEG = 0.005, 0.05
AXIS = Model(
    ("coulomb_friction", "viscous_friction_by_direction"),
    {
        "linear.gain_deg_s_per_pct": 20.0,
        "linear.tau_s": 0.53,
        "coulomb_friction.level_pct": 5.5,
        "viscous_friction_by_direction.pct_at_1000_deg_s": 20.0,
        "viscous_friction_by_direction.direction": "reverse",
    },
)
LIBRARY = (
    "coulomb_friction", "viscous_friction_by_direction", "constant_load", "bridge_voltage_drop", "duty_curve",
    "armature_inductance", "transport_delay", "quadratic_drag",
)  # fmt: skip


def wandering(rng: np.random.Generator, samples: int, time_s: float, rms_pct: float) -> np.ndarray:
    """A random torque (samples) of so much rms, its correlation dying away in ``time_s``."""
    push, stays = np.zeros(samples), float(np.exp(-STEP_S / time_s))
    for k in range(1, samples):
        push[k] = stays * push[k - 1] + np.sqrt(1.0 - stays**2) * rms_pct * rng.standard_normal()
    return push


def to_and_fro(seed: int, torque_pct: float = 0.4) -> Record:
    """12 s of an axis under control, driven to and fro at a fifth of full duty, under a quick random torque."""
    rng = np.random.default_rng(seed)
    times = np.arange(round(12.0 / STEP_S)) * STEP_S
    speed = (
        150.0 * rng.uniform(0.9, 1.1) * np.interp(times % 6.0, [0, 0.6, 2.4, 3.0, 3.6, 5.4, 6], [0, 1, 1, 0, -1, -1, 0])
    )
    duty = speed / 20.0 + 0.53 * np.gradient(speed, times) / 20.0 + 5.5 * np.sign(speed) * (np.abs(speed) > 1.0)
    duty = np.round(duty + 0.2 * rng.standard_normal(len(times)), 2)
    push = wandering(rng, len(times), 0.02, torque_pct)
    bare = make_record("bare", times, duty + push, np.zeros(len(times)), quantum=QUANTUM_DEG, at_rest=True)
    angle = np.floor(free_output(bare, Flat.of(AXIS), Start(0.0, 0.0)) / QUANTUM_DEG) * QUANTUM_DEG
    return make_record(f"axis {seed}", times, duty, angle + 0.5 * QUANTUM_DEG, quantum=QUANTUM_DEG, at_rest=True)


def slowly_pushed(seed: int, runs: int = 2, load_pct: float = 0.0) -> list[Record]:
    """Runs of 12 s of a motor with a load, under a random torque of 1 % and 0.5 s: as many wanderings as two of them
    have say little of how slow it is.
    """
    rng = np.random.default_rng(seed)
    lag_s, friction_pct = rng.uniform(0.05, 0.15), rng.uniform(1.5, 4.0)
    values = {
        "linear.gain_deg_s_per_pct": 12.0,
        "linear.tau_s": float(lag_s),
        "coulomb_friction.level_pct": float(friction_pct),
        "constant_load.level_pct": load_pct,
    }
    motor = Model(("coulomb_friction", "constant_load"), dict(values))
    records = []
    for run in range(runs):
        times = np.arange(round(12.0 / STEP_S)) * STEP_S
        duty = np.repeat(rng.uniform(-40.0, 40.0, 30), 80)
        push = wandering(rng, len(times), 0.5, 1.0)
        bare = make_record("bare", times, duty + push, np.zeros(len(times)), quantum=0.5, at_rest=True)
        angle = np.floor(free_output(bare, Flat.of(motor), Start(0.0, 0.0)) / 0.5) * 0.5
        records.append(make_record(f"run {run}", times, duty, angle + 0.25, quantum=0.5, at_rest=True))
    return records


@pytest.mark.parametrize("seed", [5, 18])
def test_a_slow_random_torque_is_no_missing_effect(seed: int) -> None:
    """Bootstrap samples with the noise that is likeliest, and judged by the truth, are too white and follow too little:
    6 of 60 such benches were said to lack something. Of these and 60 more 1 is, as chance at 1 % does.
    """
    found = diagnose_records(slowly_pushed(seed), (), Model(("coulomb_friction",)), library=())
    assert found.verdict == "no_missing_effect"


@pytest.mark.long
def test_a_torque_that_swings_by_the_clock_is_no_random_one() -> None:
    """Weights take it for one that wanders."""
    ripple: dict[str, float | str] = {"clock_ripple.level_pct": 1.0, "clock_ripple.frequency_hz": 0.65}
    records = suite(truth_model(("coulomb_friction", "clock_ripple"), ripple), 3, 20.0)
    found = diagnose_records(records, (), Model.parse("linear+coulomb_friction"), library=())
    assert found.verdict == "unexplained"
    assert "time" in found.depends_on


@pytest.mark.long
def test_whole_runs_under_a_random_torque_are_not_begun_anew_in_before_windows_are_asked() -> None:
    said: list[str] = []
    library = ("constant_load", "quadratic_drag")
    records = slowly_pushed(5, runs=3, load_pct=4.0)
    found = diagnose_records(records, (), Model(("coulomb_friction",)), library=library, say=said.append)
    assert ([s.effect for s in found.steps], found.verdict) == (["constant_load"], "explained")
    assert "whole runs are far from the floor with every effect" in said
    assert not any(text.startswith("beginning anew") for text in said)


@pytest.fixture(scope="module")
def axis() -> Diagnosis:
    """Declared without any friction: weights take that for a torque of 3.5 % that wanders slowly."""
    return diagnose_records([to_and_fro(6), to_and_fro(56)], [to_and_fro(102)], Model(), library=LIBRARY)


@pytest.mark.long
def test_friction_that_weights_take_for_a_wandering_torque_is_named(axis: Diagnosis) -> None:
    told = to_json(axis)
    assert {s["effect"] for s in told["steps"]} == {"coulomb_friction", "viscous_friction_by_direction"}
    assert (told["verdict"], told["explained_to"]) == ("explained", "noise")
    assert told["after"]["holdout"]["window_rms"] < 0.1 * told["before"]["holdout"]["window_rms"]


def test_what_the_library_does_not_name_is_not_taken_for_noise() -> None:
    """The torque that is left is half of what drives the axis."""
    found = diagnose_records([to_and_fro(2)], (), Model(), library=("quadratic_drag",))
    assert found.verdict == "unexplained"


def test_intervals_hold_what_runs_scatter_about() -> None:
    """A gain of its own in each of five runs, 1 % sd; each run knows its own a hundred times better."""
    rng = np.random.default_rng(5)
    held, narrow, sets = 0, 0, 300
    for _ in range(sets):
        inputs = [rng.uniform(20.0, 60.0, 200) for _ in range(5)]
        load = RunToRun(np.array([0.0, 0.0, 1.0]), np.zeros((3, 2)), {str(i): np.zeros(3) for i in range(5)})
        left = [10.0 * 0.01 * rng.standard_normal() * u + 0.5 * rng.standard_normal(200) for u in inputs]
        shift = sum(float(u @ r) for u, r in zip(inputs, left, strict=True)) / sum(float(u @ u) for u in inputs)
        found = Fit(
            Model(values={"linear.gain_deg_s_per_pct": 10.0 + shift}),
            ("linear.gain_deg_s_per_pct",),
            1.0,
            tuple(r - shift * u for u, r in zip(inputs, left, strict=True)),
            tuple(u[:, None] for u in inputs),
            (),
            (),
            True,
            1000.0,
        )
        low, high = estimates(found, runs=load)["linear.gain_deg_s_per_pct"].ci95
        held += low <= 10.0 <= high
        low, high = estimates(found)["linear.gain_deg_s_per_pct"].ci95
        narrow += low <= 10.0 <= high
    assert 0.90 * sets <= held <= 0.99 * sets
    assert narrow < 0.90 * sets


def slowly_reversed(seed: int) -> Record:
    """20 s of a motor with a friction of 3 %, turned to and fro by a slow sine under a random torque of 1 % and 0.5 s:
    the torque decides when the shaft sticks.
    """
    rng, times = np.random.default_rng(seed), np.arange(round(20.0 / STEP_S)) * STEP_S
    values: dict[str, float | str] = {"linear.gain_deg_s_per_pct": 12.0, "linear.tau_s": 0.06}
    motor = Model(("coulomb_friction",), {**values, "coulomb_friction.level_pct": 3.0})
    duty = 20.0 * np.sin(2.0 * np.pi * 0.1 * times)
    push = wandering(rng, len(times), 0.5, 1.0)
    bare = make_record("bare", times, duty + push, np.zeros(len(times)), quantum=0.5, at_rest=True)
    angle = np.floor(free_output(bare, Flat.of(motor), Start(0.0, 0.0)) / 0.5) * 0.5
    return make_record(f"slow {seed}", times, duty, angle + 0.25, quantum=0.5, at_rest=True)


@pytest.mark.long
def test_intervals_hold_a_friction_where_a_torque_decides_when_a_shaft_sticks() -> None:
    """By one step from the fit to each bootstrap sample they held it in 18 of these 24."""
    held = 0
    for seed in range(10, 34):
        weighed = WeighedWindows([slowly_reversed(seed)])
        stage = weighed.stage(weighed.declared(Model(("coulomb_friction",)), False))
        low, high = estimates(stage.fit, stage.scattered_models)["coulomb_friction.level_pct"].ci95
        held += low <= 3.0 <= high
    assert 21 <= held <= 24


def test_what_no_reading_hangs_on_is_not_fitted_to_bootstrap_samples() -> None:
    """A level at which a shaft that never stops would start has a derivative of nothing: it went to either bound."""
    weighed = WeighedWindows([slowly_reversed(10)])
    state = weighed.declared(Model(("coulomb_friction",)), False)
    values = {"static_friction.extra_pct": 0.5}
    model = state.fit.model.with_effect("static_friction").with_values(values)
    columns = tuple(np.column_stack((c, 1e-9 * c[:, -1])) for c in state.fit.jacobians)
    names = (*state.fit.names, "static_friction.extra_pct")
    fitted = replace(state.fit, model=model, names=names, jacobians=columns)
    found = refitted_models(fitted, state.records, np.random.default_rng(0))
    assert {m.number("static_friction.extra_pct") for m in found} == {0.5}


def test_what_noise_hides_in_windows_as_they_are_is_known_by_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    """A delay of 30 ms, fitted to 0.3 ms under a torque of 1 %, was not believed, as windows as they are held the lag
    to a factor of five: a compliance was named in its place. Of what is no noise weights promise too much.
    """
    weighed = WeighedWindows(slowly_pushed(5))
    state = weighed.declared(Model(("coulomb_friction",)), False)
    assert state.bare is not None
    hidden = replace(state, bare=replace(state.bare, residuals=tuple(1e3 * r for r in state.bare.residuals)))
    assert weighed.degenerate(hidden, ()) is None
    monkeypatch.setattr(weighed, "white", lambda state: False)
    assert "is anywhere in" in str(weighed.degenerate(hidden, ()))


def test_windows_of_long_records_are_looked_at_in_step_with_nothing() -> None:
    """A command that repeats itself every two windows is seen in both of its halves, and the motor is found."""
    rng = np.random.default_rng(0)
    n = round(2.5 * SETTINGS.most_windows / STEP_S)
    times = np.arange(n) * STEP_S
    duty = np.where(times % 2.0 < 1.0, 40.0, -30.0)
    truth = Model(values={"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.1})
    bare = make_record("long", times, duty, np.zeros(n), quantum=0.5, at_rest=True)
    angle = free_output(bare, Flat.of(truth), Start(0.0, 0.0)) + 0.5 * rng.standard_normal(n)
    windows = WeighedWindows([make_record("long", times, duty, angle, quantum=0.5, at_rest=True)])
    firsts = np.concatenate([r.looked_at[0] * STEP_S + r.excitation.clock_s for r in windows.plain])
    assert 0.8 * SETTINGS.most_windows <= len(firsts) <= SETTINGS.most_windows + len(windows.plain)
    halves = np.bincount((firsts % 2.0 >= 1.0).astype(int), minlength=2)
    assert halves.min() > 0.4 * len(firsts)
    found = fit(truth.with_values({"linear.tau_s": 0.2}), windows.plain, windows=True).model
    assert found.number("linear.gain_deg_s_per_pct") == pytest.approx(10.0, rel=1e-3)
    assert found.number("linear.tau_s") == pytest.approx(0.1, rel=0.01)


@pytest.mark.parametrize(
    ("seed", "more"),
    [(1, {}), (2, {}), (3, {}), (1, {"coast_pwm": 0.1}), (2, {"coast_pwm": 0.3}), (3, {"quadratic_drag": 40.0})],
)
def test_a_true_model_leaves_white_windows_where_a_torque_turns_or_holds_the_shaft(
    seed: int, more: dict[str, float]
) -> None:
    """Reversals, starts and stops under a torque of 1 %: nothing there stands out of what the noise explains, also
    where speeds settle sooner or later than the lag says.
    """
    rng = np.random.default_rng(seed)
    values = {"linear.gain_deg_s_per_pct": 15.7, "linear.tau_s": 0.07, "coulomb_friction.level_pct": 5.1}
    truth, n = Model(("coulomb_friction",), values), round(60.0 / STEP_S)
    for name, size in more.items():
        truth = truth.with_effect(name, {effect(name).parameters[0].name: size})
    known = Noise(Ranged(0.0, 0.0, 0.0), Ranged(1.0, 1.0, 1.0), Ranged(0.5, 0.5, 0.5))
    times, holds = np.arange(n) * STEP_S, rng.integers(40, 300, 300)
    duty = np.repeat(rng.uniform(-80.0, 80.0, 300), holds)[:n] * np.repeat(rng.random(300) > 0.3, holds)[:n]
    bare = make_record("bare", times, duty, np.zeros(n), quantum=0.5, at_rest=True)
    angle = np.floor(disturbed_output(bare, truth, Start(0.0, 0.0), known, rng) / 0.5) * 0.5 + 0.25
    record = make_record("run", times, duty, angle, quantum=0.5, at_rest=True)
    (start,) = fit(truth, [record], windows=True, max_iterations=1, tolerance=1e30).starts
    moves = at_rest(movement(record, truth, start), standing(record, truth, start, 1.0))
    (whitened,) = with_noise([record], truth, known, [moves])
    left = windowed(whitened, Flat.of(truth), start)[0]
    assert np.sqrt(np.mean(left**2)) == pytest.approx(0.95, abs=0.2)
    assert np.abs(left).max() < 5.5


def test_a_winding_is_not_taken_for_a_delay_because_it_shows_noise_otherwise() -> None:
    """A change of speed of which the current knows nothing yet is braked by nothing: with that lag the true model left
    more than one without a winding, in 11 of 12 drawn benches.
    """
    ahead = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        values = {"linear.gain_deg_s_per_pct": 7.0, "linear.tau_s": 0.06, "coulomb_friction.level_pct": 3.0}
        motor = Model(("coulomb_friction",), values)
        truth = motor.with_effect("armature_inductance", {"time_constant_s": 0.009})
        known = Noise(Ranged(0.0, 0.0, 0.0), Ranged(0.5, 0.5, 0.5), Ranged(0.1, 0.1, 0.1))
        times, n = np.arange(round(24.0 / STEP_S)) * STEP_S, round(24.0 / STEP_S)
        duty = np.repeat(rng.uniform(-80.0, 80.0, 100), rng.integers(50, 150, 100))[:n]
        bare = make_record("bare", times, duty, np.zeros(n), quantum=0.5, at_rest=True)
        angle = disturbed_output(bare, truth, Start(0.0, 0.0), known, rng) + 0.5 * rng.standard_normal(n)
        record = make_record("run", times, duty, np.floor(angle / 0.5) * 0.5 + 0.25, quantum=0.5, at_rest=True)
        windows = WeighedWindows([record])
        delayed = motor.with_effect("transport_delay", {"delay_s": 0.009})
        of_each = [windows.settled(fit(m, windows.records, windows=True)).deviance for m in (truth, delayed)]
        ahead.append(of_each[1] - of_each[0])
    assert min(ahead) > 0.0, ahead


def test_where_the_sensor_s_counts_are_all_that_is_left_the_floor_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rounding is no noise: how white it looks hangs on a tenth of a count, which no whole run is asked for either."""
    monkeypatch.setattr(WeighedWindows, "_looks_white", lambda self, state: False)
    truth, rng = truth_model(), np.random.default_rng(3)
    exact = suite(truth, 3)
    shaky = [replace(r, y=r.y + r.quantum * np.round(2.0 * rng.standard_normal(len(r)))) for r in exact]
    for records, counts in ((exact, True), (shaky, False)):
        windows = WeighedWindows(records)
        state = windows.settled(fit(truth, windows.records, windows=True))
        assert state.noise is not None
        assert state.noise.only_counts is counts
        assert windows.stage(state).follows
        assert windows.white(state) is counts


def test_a_threshold_that_its_own_noise_hides_is_searched_in_windows_as_they_are() -> None:
    """A shaft that starts at another time leaves in some windows what weights take for a random torque."""
    values = {"coulomb_friction.level_pct": 4.3, "static_friction.extra_pct": 2.1}
    truth = truth_model(("coulomb_friction", "static_friction"), values)
    windows = WeighedWindows(suite(truth, 5, 10.0))
    wrong = windows.settled(fit(truth.with_values({"static_friction.extra_pct": 1.2}), windows.plain, windows=True))
    assert wrong.noise is not None
    assert wrong.noise.torque_pct.value > 0.1
    found = windows.finished(wrong)
    assert found.noise is not None
    assert found.noise.torque_pct.value < 0.02
    assert abs(found.fit.model.number("static_friction.extra_pct") - 2.1) < 0.3
    assert found.deviance < wrong.deviance - 1000.0


def test_what_is_carried_to_its_minimum_begins_under_noise_and_in_windows_as_they_are() -> None:
    """Whichever of the two showed that it is worth one: where friction turns, the two lead to different minima."""
    windows = WeighedWindows([to_and_fro(3)])
    state = windows.settled(fit(truth_model(("coulomb_friction",)), windows.records, windows=True))
    beside = LogsBeside(windows, state)
    beside.ranked = [ranked(screen, [effect(name) for name in LIBRARY[1:]], False) for screen in beside.screens]
    shown = Job(next(s for s in beside.ranked[1] if s.trials), beside.screens[1].fit, beside.screens[1].records)
    jobs, rough = beside.by_every_screen(*rough_fits(beside.logs, [shown], np.inf), np.inf)
    assert [job.name for job in jobs] == [shown.name] * 2
    assert [job.records is screen.records for job, screen in zip(jobs, beside.screens[::-1], strict=True)] == [True] * 2
    assert all(f.cost < job.base.cost for job, f in zip(jobs, rough, strict=True))


def test_a_name_gains_though_steady_motion_knows_nothing_of_what_more_is_missing() -> None:
    """A deadband explains steady motion to the count; where the shaft creeps from tooth to tooth cogging is left, which
    noise of that size does not hold. Less likely than the model without it the deadband cannot be.
    """
    sizes = {"input_deadband.level_pct": 5.0, "cogging_torque.order": 12.0, "cogging_torque.level_pct": 2.6}
    slow = {"linear.gain_deg_s_per_pct": 100.0, "linear.tau_s": 0.15}
    truth = truth_model(("coulomb_friction", "input_deadband", "cogging_torque"), {**slow, **sizes})
    rng = np.random.default_rng(1)
    logs = WeighedWindows([measure(truth, steps(8.0, rng), rng, name=f"run {k}") for k in range(3)])
    declared = logs.declared(Model.parse("linear+coulomb_friction"), False)
    ((_, found),) = LogsBeside(logs, declared).refitted([effect("input_deadband")], lambda text: None)
    assert found.fit.model.number("input_deadband.level_pct") == pytest.approx(5.0, abs=1.0)
    assert declared.deviance - found.deviance > 300.0
    alone = logs.settled(again(declared.fit, found.fit.model, declared.records))
    assert alone.fit.rms > 1.5
    assert alone.deviance > declared.deviance
    assert alone.variance == pytest.approx(alone.fit.rms**2)
