"""The deadband by ramps and by steps, over angles and repeats, and the bench profile that keeps it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from places import ROOT

from fiohost.bench.connect import connect
from fiohost.bench.deadband import Deadband, measure_deadband
from fiohost.bench.profile import BenchProfile
from fiohost.cli.main import cli
from fiohost.errors import ConfigError, DataError

FRICTION_PCT = 100.0 * 0.02045 * 5.515 / (0.3408 * 9.0)  # of the default plant: torque over stall torque at full duty


def measured(method: str, target: str = "sim", **settings: int) -> Deadband:
    with connect(target, seed=1) as bench:
        return measure_deadband(bench, 2, method=method, **settings)


@pytest.mark.parametrize("method", ["ramp", "steps"])
def test_both_methods_find_the_dry_friction_of_the_board(method: str) -> None:
    found = measured(method, angles=2)
    assert found.u_plus_pct == pytest.approx(FRICTION_PCT, abs=0.15)
    assert found.u_minus_pct == pytest.approx(-FRICTION_PCT, abs=0.15)
    assert found.as_dict()["method"] == method
    assert len(found.onsets) == 2 * 2 * 2
    assert [o.place_deg for o in found.onsets] == [0.0, 0.0, 180.0, 180.0] * 2


def board_with(effect: str, tmp_path: Path) -> str:
    plant = tmp_path / "plant.toml"
    plant.write_text((ROOT / "configs" / "plants" / "default.toml").read_text() + f"\n[effects.{effect}\n")
    return f"sim:{plant}"


def test_steps_find_the_break_away_of_a_shaft_that_sticks_harder_than_it_slides(tmp_path: Path) -> None:
    found = measured("steps", board_with("static_friction]\nextra_Nm = 0.01112", tmp_path))  # 2 % of full duty
    assert found.u_plus_pct == pytest.approx(FRICTION_PCT + 2.0, abs=0.3)
    assert found.u_minus_pct == pytest.approx(-FRICTION_PCT - 2.0, abs=0.3)


def test_a_weight_shows_over_the_turn_and_not_between_repeats(tmp_path: Path) -> None:
    found = measured("steps", board_with("gravity_load]\ntorque_Nm = 0.01\nphase_rad = 0.0", tmp_path), angles=4)
    for forward in (True, False):
        over_angle, over_repeats = found.spread_over_angle_pct(forward), found.spread_over_repeats_pct(forward)
        assert over_angle is not None
        assert over_repeats is not None
        assert over_angle > 0.8
        assert over_repeats < 0.3
        assert list(found.places(forward)) == [0.0, 90.0, 180.0, 270.0]


def test_spreads_are_not_known_without_places_or_repeats() -> None:
    found = measured("steps")
    assert found.spread_over_angle_pct(True) is None
    with connect("sim") as bench:
        once = measure_deadband(bench, 1, method="steps", angles=2)
    assert once.spread_over_repeats_pct(True) is None
    assert once.spread_over_angle_pct(True) is not None


def test_a_motor_that_cannot_start_is_said_by_steps_too() -> None:
    with connect("sim") as bench, pytest.raises(DataError, match="does not start"):
        measure_deadband(bench, 1, max_pct=2.0, method="steps")


@pytest.mark.parametrize("wrong", [{"method": "step"}, {"angles": -1}, {"angles": 361}])
def test_a_sweep_that_is_none_is_refused(wrong: dict[str, object]) -> None:
    with connect("sim") as bench, pytest.raises(ConfigError):
        measure_deadband(bench, 1, **wrong)  # type: ignore[arg-type]


# ---- the profile ---------------------------------------------------------------------------------------------------


def test_a_profile_is_read_as_it_was_written(tmp_path: Path) -> None:
    wanted = BenchProfile('a "bench"\\1', "steps", 4.0, -3.5, 0.1, 0.2, 0.6)
    wanted.save(tmp_path / "bench.toml")
    found = BenchProfile.load(tmp_path / "bench.toml")
    assert found.compensation_pct == pytest.approx((2.4, -2.1))
    assert (found.u_plus_pct, found.u_minus_spread_pct, found.method) == (4.0, 0.2, "steps")


HEAD = 'schema = "fiohost.bench/1"\n[deadband]\nu_plus_pct = 4.0\nu_minus_pct = -3.0\n'


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (HEAD.replace("-3.0", "3.0"), "u_minus_pct"),
        (HEAD + "u_pluss_pct = 1.0\n", "did you mean"),
        (HEAD + "[compensation]\nshare = 2.0\n", "share"),
        (HEAD + "[compensaton]\n", "did you mean 'compensation'"),
        (HEAD.replace("bench/1", "bench/2"), "schema"),
        ('schema = "fiohost.bench/1"\n', "deadband"),
        (HEAD + 'method = "slope"\n', "method"),
    ],
)
def test_a_profile_that_is_wrong_is_refused_by_key(text: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text(text)
    with pytest.raises(ConfigError, match=reason):
        BenchProfile.load(tmp_path / "bench.toml")


def test_the_command_saves_a_profile_of_what_it_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["deadband", "--method", "steps", "--angles", "2", "--repeats", "2", "--save", "b.toml", "--json", "b.json"]
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 0, result.output
    found = json.loads(Path("b.json").read_text())
    assert BenchProfile.load("b.toml").u_plus_pct == found["u_plus_pct"]
    assert found["u_minus_spread_over_angle_pct"] is not None
    assert "between repeats at one place" in result.output
    refused = CliRunner().invoke(cli, ["deadband", "--method", "stesp"])
    assert refused.exit_code == 1
    assert "steps" in refused.output
