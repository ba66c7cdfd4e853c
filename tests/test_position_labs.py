"""The experiments of the position control lab on the simulated board: what they find is what is in the board."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from places import ROOT

import fiohost
from fiohost.bench.experiment import Experiment
from fiohost.bench.profile import BenchProfile
from fiohost.bench.signals import Square
from fiohost.cli.main import cli
from fiohost.control.jitter import JITTER, LIMIT_CYCLE, REST, find_jitter
from fiohost.control.settings import ControlSettings
from fiohost.control.specification import Specification
from fiohost.errors import DataError
from fiohost.labs.design import design_lab
from fiohost.labs.identification import identification
from fiohost.labs.precompensation import precompensation

# The default plant (9 V): full-duty speed 9/Ke, friction torque over stall torque, J R / (Kt Ke).
GAIN, TAU_S, FRICTION_PCT = np.degrees(9.0 / 0.4869) / 100.0, 3.07e-3 * 5.515 / (0.3408 * 0.4869), 3.676
PROFILE = BenchProfile("sim", "ramp", 3.75, -3.75, share=0.8)


# ---- jitter --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("swing_deg", "hz", "kind", "rate"),
    [(0.0, 0.0, REST, 0.0), (0.5, 10.0, JITTER, 20.0), (1.0, 5.0, JITTER, 10.0), (3.0, 4.0, LIMIT_CYCLE, 8.0)],
)
def test_jitter_is_told_from_a_limit_cycle_by_its_swing(swing_deg: float, hz: float, kind: str, rate: float) -> None:
    times = np.arange(400) * 0.005
    wave = np.sin(2.0 * np.pi * hz * times + 0.1)
    angle = 170.0 + swing_deg * (wave > 0.0)
    found = find_jitter(times, 5.0 * np.sign(wave) if hz else np.zeros(400), angle, 0.5)
    assert found.kind == kind
    assert found.reversals_per_s == pytest.approx(rate, abs=1.1)
    assert found.frequency_hz == pytest.approx(hz, abs=0.6)
    with pytest.raises(DataError):
        find_jitter(times[:1], angle[:1], angle[:1], 0.5)


@pytest.mark.parametrize("kind", ["pd", "pi", "pid"])
def test_a_loop_goes_through_zero_without_a_jump(kind: str) -> None:
    settings = ControlSettings(kind, 1.0, 0.02, 0.01, "angle", ki_pct_per_deg_s=0.2, tracking_s=1.0)
    across = Square(duration_s=6.0, low=350.0, high=370.0, period_s=3.0)
    with fiohost.connect("sim:ideal") as bench:
        log = bench.run(Experiment("across", reference=(across,), control=settings))
    later = log.time_s > 1.5
    assert np.ptp(log.columns["pos"][later]) > 600  # the counter wrapped
    assert np.max(np.abs(log.duty_pct[later])) < 60.0
    assert np.max(np.abs(np.diff(log.output[later]))) < 5.0
    assert np.max(np.abs(log.columns["ref_deg"] - log.output)[later]) < 40.0


# ---- precompensation -----------------------------------------------------------------------------------------------


def test_the_compensation_is_reduced_until_the_loop_rests(tmp_path: Path) -> None:
    with fiohost.connect("sim") as bench:
        result, kept = precompensation(bench, tmp_path, PROFILE, shares=(0.0, 0.9, 1.0, 3.0))
    sweep = {row["share"]: row for row in result.values["sweep"]}
    assert sweep[1.0]["kind"] != REST  # behind friction of 3.68 % a compensation of 3.75 % holds nothing
    assert sweep[3.0]["kind"] == LIMIT_CYCLE
    assert 0.5 < kept.share < 1.0
    assert sweep[kept.share]["kind"] == REST
    above = [row for share, row in sweep.items() if kept.share < share <= 1.0]
    assert above
    assert all(row["kind"] != REST for row in above)
    assert kept.share * kept.u_plus_pct < FRICTION_PCT
    assert (kept.u_plus_pct, kept.u_minus_pct) == (3.75, -3.75)
    for draw in result.figures.values():
        assert draw().axes


def test_a_controller_that_rests_within_a_count_needs_no_reduction(tmp_path: Path) -> None:
    calm = ControlSettings(threshold_pct=0.6)  # an error of a count commands nothing
    with fiohost.connect("sim") as bench:
        _, kept = precompensation(bench, tmp_path, PROFILE, calm, shares=(0.0, 1.0))
    assert kept.share == 1.0


# ---- identification ------------------------------------------------------------------------------------------------


def test_friction_explains_what_the_two_methods_miss(tmp_path: Path) -> None:
    with fiohost.connect("sim") as bench:
        result = identification(bench, tmp_path, PROFILE)
    values = result.values
    truth = {name: item["value"] for name, item in values["with_friction"]["parameters"].items()}
    assert truth["linear.gain_deg_s_per_pct"] == pytest.approx(GAIN, rel=0.02)
    assert truth["linear.tau_s"] == pytest.approx(TAU_S, rel=0.05)
    assert truth["coulomb_friction.level_pct"] == pytest.approx(FRICTION_PCT, abs=0.2)
    for method in ("step", "pem"):
        measured = values[method]["parameters"]["tau_s"]["value"]
        assert measured < 0.9 * TAU_S
        assert abs(values["simulated_with_friction"][method]["tau_s"] - measured) < 0.5 * (TAU_S - measured)
        assert values["simulated_without"][method]["tau_s"] == pytest.approx(TAU_S, rel=0.2)
    assert [row[0] for row in result.tables[1].rows][:3] == ["step", "pem", "with friction"]
    assert fiohost.Model.read(Path(result.files["model with friction"])).effects == (
        "coulomb_friction",
        "armature_inductance",
    )
    assert result.figures["identification"]().axes


def test_a_loop_that_does_not_follow_identifies_nothing(tmp_path: Path) -> None:
    plant = (ROOT / "configs" / "plants" / "default.toml").read_text().replace("0.02045", "0.2")
    (tmp_path / "stiff.toml").write_text(plant)
    with fiohost.connect(f"sim:{tmp_path / 'stiff.toml'}") as bench, pytest.raises(DataError, match="asked for"):
        identification(bench, tmp_path, PROFILE)


def test_a_board_with_more_than_friction_is_said_not_to_be_explained_by_it(tmp_path: Path) -> None:
    plant = (ROOT / "configs" / "plants" / "default.toml").read_text()
    (tmp_path / "weight.toml").write_text(plant + "\n[effects.gravity_load]\ntorque_Nm = 0.012\nphase_rad = 1.0\n")
    with fiohost.connect(f"sim:{tmp_path / 'weight.toml'}") as bench:
        result = identification(bench, tmp_path, PROFILE)
    text = " ".join(answer.answer for answer in result.answers)
    assert "fiohost diagnose" in text


# ---- design --------------------------------------------------------------------------------------------------------


def test_the_design_meets_the_texts_specification_on_the_board(tmp_path: Path) -> None:
    with fiohost.connect("sim") as bench:
        result = design_lab(bench, tmp_path, Specification(), "pd", PROFILE)
    values = result.values
    assert values["feasible"]
    assert values["met_on_target"]
    for square in values["squares"]:
        assert len(square["measured"]) == len(square["simulated"]) == 5
        assert square["difference_rms_deg"] < 1.0
        for step in square["measured"]:
            assert step["overshoot_pct"] < 5.0
            assert step["settling_s"] < 0.5
            assert step["error_deg"] < 1.0
    assert {(s["low_deg"], s["high_deg"]) for s in values["squares"]} == {(170, 190), (135, 225), (90, 270)}
    assert ControlSettings.load(Path(result.files["controller"])).kind == "pd"
    for draw in result.figures.values():
        assert len(draw().axes) == 4


def test_a_design_that_fails_on_the_board_is_said_to(tmp_path: Path) -> None:
    wrong = fiohost.Model(values={"linear.gain_deg_s_per_pct": 3.0, "linear.tau_s": 0.02})
    with fiohost.connect("sim") as bench:
        result = design_lab(bench, tmp_path, Specification(), "pd", PROFILE, wrong)
    assert not result.values["met_on_target"]
    assert "NO" in [row[-1] for row in result.tables[1].rows]


# ---- the commands --------------------------------------------------------------------------------------------------


def test_the_labs_run_one_after_another_from_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    PROFILE.save("bench.toml")
    for words in (
        ["identification", "--profile", "bench.toml"],
        ["design", "--profile", "bench.toml", "--model", "lab/identification_model_with_friction.toml"],
    ):
        result = CliRunner().invoke(cli, ["lab", *words, "--json", f"{words[0]}.json"])
        assert result.exit_code == 0, result.output
        found = json.loads(Path(f"{words[0]}.json").read_text())
        assert found["schema"] == "fiohost.lab/1"
        for path in found["files"].values():
            assert Path(path).is_file()
    refused = CliRunner().invoke(cli, ["lab", "precompensation", "--profile", "none.toml"])
    assert refused.exit_code == 1
    assert "none.toml" in refused.output
