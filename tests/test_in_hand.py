"""What is handed over: the best usable model in every case, and how far it may be believed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from short_runs import logs_of, plant_file, random_steps

from fiohost.cli.main import cli
from fiohost.control.design import design
from fiohost.discover.diagnose import diagnose_records
from fiohost.discover.logs.unnamed import with_curves
from fiohost.discover.result import to_json
from fiohost.errors import FiohostError
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import Record, make_record
from fiohost.estimation.seen import seen_of
from fiohost.motor.model import Model
from fiohost.motor.seen import Seen
from fiohost.motor.simulate import Start
from fiohost.report.outlook import curves_sentence, extrapolation_sentences

STEP_S = 0.005
VALUES = {"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.08, "coulomb_friction.level_pct": 3.0}
DECLARED = Model(("coulomb_friction",), VALUES)
BUMP = {"point_3_pct": 2.5, "point_4_pct": -1.0, "point_8_pct": 1.5}


def run_of(model: Model, seed: int, seconds: float = 16.0, most: float = 40.0) -> Record:
    rng = np.random.default_rng(seed)
    n = round(seconds / STEP_S)
    times, duty = np.arange(n) * STEP_S, np.repeat(rng.uniform(-most, most, n // 100 + 1), 100)[:n]
    bare = make_record(f"run {seed}", times, duty, np.zeros(n), quantum=0.5, at_rest=True)
    y = free_output(bare, Flat.of(model), Start(0.0, 0.0))
    return make_record(f"run {seed}", times, duty, np.floor(y / 0.5) * 0.5 + 0.25, quantum=0.5, at_rest=True)


@pytest.mark.long
def test_a_load_that_no_name_fits_is_handed_over_as_a_curve() -> None:
    bench = DECLARED.with_effect("load_over_position", BUMP)
    train, held = [run_of(bench, seed) for seed in (1, 2, 3)], [run_of(bench, 4)]
    found = diagnose_records(train, held, DECLARED, library=["quadratic_drag"])
    told = to_json(found)
    assert told["verdict"] == "unexplained"
    assert told["unnamed"]["effects"] == ["load_over_position"]
    points = np.array(told["unnamed"]["curves"][0]["points"])
    truth = [0.0, 0.0, 2.5, -1.0, 0.0, 0.0, 0.0, 1.5, 0.0, 0.0, 0.0, -3.0]
    assert points[:, 1] == pytest.approx(truth, abs=0.1)
    assert points[:, 0] == pytest.approx(30.0 * np.arange(12))
    assert told["unnamed"]["after"]["window_rms"] < 0.2 * told["unnamed"]["before"]["window_rms"]
    assert "load over position" in curves_sentence(told)
    assert "load_over_position" in found.in_hand.effects
    assert "load_over_position" not in found.final.fit.model.effects  # it names nothing


@pytest.mark.long
@pytest.mark.parametrize("name", ["load_over_position", "friction_over_position"])
def test_a_curve_of_any_shape_is_named_where_no_sine_does_as_well(name: str) -> None:
    bench = DECLARED.with_effect(name, BUMP)
    found = diagnose_records([run_of(bench, seed) for seed in (1, 2, 3)], [run_of(bench, 4)], DECLARED)
    assert (found.verdict, [s.effect for s in found.steps]) == ("explained", [name])
    assert found.final.fit.model.number(f"{name}.point_3_pct") == pytest.approx(2.5, abs=0.1)
    sine = DECLARED.with_effect("gravity_load", {"level_pct": 2.0, "phase_deg": 40.0})
    found = diagnose_records([run_of(sine, seed) for seed in (1, 2, 3)], [], DECLARED)
    assert [s.effect for s in found.steps] == ["gravity_load"]


def test_no_curve_is_laid_where_none_is_asked_for() -> None:
    assert with_curves(DECLARED, [run_of(DECLARED, seed) for seed in (1, 2, 3)]) is None


def test_what_a_model_was_fitted_to_goes_with_its_file(tmp_path: Path) -> None:
    seen = seen_of([run_of(DECLARED, seed, most=9.0) for seed in (1, 2)])
    path = tmp_path / "found.toml"
    replace(DECLARED, seen=seen).write(path)
    again = Model.read(path)
    assert again == DECLARED
    assert again.seen == seen
    path.write_text(path.read_text() + "holds_s = 1.0\n")
    with pytest.raises(FiohostError, match="holds_s"):
        Model.read(path)


def test_a_log_beyond_the_training_logs_is_told_where() -> None:
    train, held = [run_of(DECLARED, seed, most=9.0) for seed in (1, 2, 3)], [run_of(DECLARED, 4, most=60.0)]
    told = to_json(diagnose_records(train, held, DECLARED, library=["quadratic_drag"]))
    (one,) = told["extrapolates"]
    assert one["log"] == "run 4"
    assert any(part.startswith("duty") for part in one["beyond"])
    assert any(part.startswith("speed") and "deg/s" in part for part in one["beyond"])
    assert "there the model extrapolates" in extrapolation_sentences(told)[0]
    within = [replace(run_of(DECLARED, 1, most=8.9), name="run 5")]
    assert to_json(diagnose_records(train, within, DECLARED, library=["quadratic_drag"]))["extrapolates"] == []


def test_commands_held_longer_and_an_open_bridge_are_beyond_too() -> None:
    seen = Seen((-10.0, 10.0), (-80.0, 80.0), 1.6, False)
    parts = seen.beyond(replace(seen, hold_s=5.02, coasted=True))
    assert parts == ["a command held 5.02 s, longest seen 1.6 s", "an open bridge, never seen"]
    assert seen.beyond(replace(seen, duty_pct=(-10.5, 10.5), hold_s=1.7)) == []


def test_a_log_beyond_what_a_model_was_fitted_to_is_refused_where_that_is_asked_for(tmp_path: Path) -> None:
    runner, out, found = CliRunner(), tmp_path / "simulated.csv", tmp_path / "found.toml"
    (log,) = logs_of(f"sim:{plant_file(tmp_path)}", tmp_path, [random_steps(4.0)])
    args = ["simulate", str(log.path), "--model", str(found), "-o", str(out)]
    replace(DECLARED, seen=Seen((-9.0, 9.0), (-60.0, 60.0), 5.0, True)).write(found)
    refused = runner.invoke(cli, [*args, "--within"])
    assert refused.exit_code == 1
    assert "goes beyond what the model was fitted to: duty" in refused.output
    assert not out.exists()
    noted = runner.invoke(cli, args)
    assert noted.exit_code == 0
    assert "the model extrapolates" in noted.output
    out.unlink()
    found.unlink()
    DECLARED.write(found)
    assert "does not say what it was fitted to" in runner.invoke(cli, [*args, "--within"]).output
    found.unlink()
    replace(DECLARED, seen=Seen((-100.0, 100.0), (-1500.0, 1500.0), 5.0, True)).write(found)
    assert runner.invoke(cli, [*args, "--within"]).exit_code == 0


def test_a_design_that_asks_for_more_duty_than_was_seen_says_so() -> None:
    seen = Seen((-9.0, 9.0), (-60.0, 60.0), 2.0, False)
    found = design(replace(DECLARED, seen=seen), "p", steps_deg=[90.0])
    assert any("extrapolates: duty" in note for note in found.notes)
    assert not any("extrapolates" in note for note in design(DECLARED, "p", steps_deg=[90.0]).notes)
