"""Held-out logs judged with what differs from run to run taken from their own beginnings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fiohost.discover.logs.own_start import OwnSettings, from_zero, own_starts, pooled
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import Record, make_record
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.estimate import NONE, Ranged
from fiohost.noise.runs import RunToRun

STEP_S = 0.005
FITTED = Model(
    ("coulomb_friction",),
    {"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.08, "coulomb_friction.level_pct": 3.0},
)


def run_of(model: Model, seconds: float = 24.0, seed: int = 0, end: float | None = None) -> Record:
    """A run of a model through counts of half a degree; after ``end`` seconds it turns at twice the gain."""
    rng = np.random.default_rng(seed)
    n = round(seconds / STEP_S)
    times = np.arange(n) * STEP_S
    duty = np.repeat(rng.choice([-60.0, -30.0, 25.0, 45.0, 70.0], n // 100 + 1), 100)[:n]
    bare = make_record("held", times, duty, np.zeros(n), quantum=0.5, at_rest=True)
    y = free_output(bare, Flat.of(model), Start(0.0, 0.0))
    if end is not None:
        other = free_output(bare, Flat.of(model.with_values({"linear.gain_deg_s_per_pct": 20.0})), Start(0.0, 0.0))
        y = np.where(times < end, y, other)
    return make_record("held", times, duty, np.floor(y / 0.5) * 0.5 + 0.25, quantum=0.5, at_rest=True)


def test_gain_friction_load_and_dead_time_of_a_run_come_from_its_beginning() -> None:
    own = {"linear.gain_deg_s_per_pct": 10.4, "coulomb_friction.level_pct": 3.6}
    bench = FITTED.with_values(own).with_effect("constant_load", {"level_pct": 0.7})
    bench = bench.with_effect("transport_delay", {"delay_s": 0.004})
    (found,) = own_starts([run_of(bench)], FITTED, NONE)
    assert found is not None
    told = {key: value for key, (value, _) in found.values.items()}
    assert told["linear.gain_deg_s_per_pct"] == pytest.approx(10.4, rel=2e-3)
    assert told["coulomb_friction.level_pct"] == pytest.approx(3.6, abs=0.15)
    assert told["constant_load.level_pct"] == pytest.approx(0.7, abs=0.1)
    assert told["transport_delay.delay_s"] == pytest.approx(0.004, abs=0.001)
    assert found.own.errors.window_rms < 0.3 * found.cold.errors.window_rms
    assert found.own.errors.free_run_rms < 0.1 * found.cold.errors.free_run_rms


def test_what_runs_of_the_bench_do_not_differ_by_is_not_the_own_of_one() -> None:
    """At one speed a load that helps would do for a gain, and drive a motor that has no friction on and on."""
    model = FITTED.without(["coulomb_friction"]).with_effect("bridge_voltage_drop", {"drop_pct": 2.0})
    n = round(24.0 / STEP_S)
    times, duty = np.arange(n) * STEP_S, np.full(n, 70.0)
    bare = make_record("held", times, duty, np.zeros(n), quantum=0.5, at_rest=True)
    y = free_output(bare, Flat.of(model.with_values({"linear.gain_deg_s_per_pct": 10.1})), Start(0.0, 0.0))
    record = make_record("held", times, duty, np.floor(y / 0.5) * 0.5 + 0.25, quantum=0.5, at_rest=True)
    noise = replace(NONE, torque_pct=Ranged(0.4, 0.4, 0.4), torque_s=Ranged(0.05, 0.05, 0.05))
    noise = replace(noise, runs=RunToRun(np.array([0.01, 0.0, 0.0]), np.zeros((3, 2))))
    (found,) = own_starts([record], model, noise)
    assert found is not None
    assert found.values["constant_load.level_pct"][0] == 0.0
    assert found.own.errors.free_run_rms <= 1.01 * found.cold.errors.free_run_rms


def test_what_comes_after_the_beginning_decides_nothing() -> None:
    one, other = run_of(FITTED), run_of(FITTED, end=12.0)
    (same,), (changed,) = (own_starts([r], FITTED, NONE) for r in (one, other))
    assert same is not None
    assert changed is not None
    assert changed.values == same.values
    assert changed.own.errors.window_rms > 10.0 * same.own.errors.window_rms


def test_a_beginning_that_says_little_leaves_the_fitted_values() -> None:
    n = round(24.0 / STEP_S)
    still = make_record("still", np.arange(n) * STEP_S, np.zeros(n), np.full(n, 0.25), quantum=0.5, at_rest=True)
    (found,) = own_starts([still], FITTED, NONE)
    assert found is not None
    assert found.values["linear.gain_deg_s_per_pct"][0] == pytest.approx(10.0, rel=1e-6)


def test_short_records_and_no_seconds_have_no_own_start() -> None:
    assert own_starts([run_of(FITTED, 2.0)], FITTED, NONE) == [None]
    assert own_starts([run_of(FITTED)], FITTED, NONE, settings=OwnSettings(seconds=0.0)) == [None]
    assert pooled([None]) is None


def test_a_model_counted_from_another_zero_is_the_same_bench() -> None:
    model = FITTED.with_effect("gravity_load", {"level_pct": 2.0, "phase_deg": 30.0})
    model = model.with_effect("encoder_eccentricity", {"level_deg": 0.8, "order": 2.0, "phase_deg": 10.0})
    times = np.arange(400) * STEP_S
    bare = make_record("run", times, np.full(400, 40.0), np.zeros(400), quantum=0.0, at_rest=True)
    there = free_output(bare, Flat.of(model), Start(75.0, 0.0))
    here = free_output(bare, Flat.of(from_zero(model, 75.0)), Start(0.0, 0.0))
    # The reading of an eccentric disc begins where the shaft stands, not where the reading says.
    assert here - here[0] == pytest.approx(there - there[0], abs=1e-6)


def test_where_a_run_counts_from_is_found_with_its_own_gain() -> None:
    """At a wrong speed angles drift by more within a window than the error of the shaft's angle swings."""
    swings = {"level_1_deg": 0.5, "phase_1_deg": -160.0, "level_2_deg": 0.08, "phase_2_deg": -70.0}
    swings |= {"level_3_deg": 0.04, "phase_3_deg": -50.0}
    model = FITTED.with_effect("shaft_angle_error", swings)
    errors = []
    for seed, duty_pct in enumerate((25.0, 45.0, 75.0, 95.0)):
        own = from_zero(model.with_values({"linear.gain_deg_s_per_pct": 10.0 * 1.015}), 70.0 * seed)
        n = round(24.0 / STEP_S)
        times, duty = np.arange(n) * STEP_S, np.full(n, duty_pct)
        bare = make_record("held", times, duty, np.zeros(n), quantum=0.5, at_rest=True)
        y = free_output(bare, Flat.of(own), Start(0.0, 0.0))
        counted = np.floor(y / 0.5) * 0.5 + 0.25
        record = make_record("held", times, duty, counted, quantum=0.5, at_rest=True, own_zero=True)
        (found,) = own_starts([record], model, NONE)
        assert found is not None
        errors.append(found.own.errors.window_rms)
    assert max(errors) < 1.15 * 0.5 / np.sqrt(12.0)
