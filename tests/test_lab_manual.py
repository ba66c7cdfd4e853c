"""``fiohost lab manual``: dead zone, friction, brake and standby as they are in the plant."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from places import ROOT
from test_cli_drive import fiohost

from fiohost.bench.log import Log

DEFAULT = (ROOT / "configs" / "plants" / "default.toml").read_text()


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def observed(*arguments: str) -> tuple[dict[str, Any], str]:
    """The result as JSON, and all answers as one text."""
    done = fiohost("lab", "manual", "--report", "out", "--json", "out.json", "--force", *arguments)
    assert done.exit_code == 0, done.output
    result = json.loads(Path("out.json").read_text())
    return result, " ".join(answer["answer"] for answer in result["answers"])


def test_the_staircase_shows_the_plants_gain_and_dry_friction() -> None:
    result, said = observed()
    values = result["values"]
    # Pybricks' constants at 9 V: 0.02045 N m on 0.3408 N m/A and 5.515 ohm is 3.68 %; 9 V on 0.4869 V s/rad is
    # 10.59 deg/s for each percent
    for way, sign in (("forward", 1.0), ("reverse", -1.0)):
        assert values[f"{way}_gain_deg_s_per_pct"] == pytest.approx(10.59, rel=0.01)
        assert values[f"{way}_dry_friction_pct"] == pytest.approx(sign * 3.68, abs=0.1)
    assert values["u_plus_pct"] == pytest.approx(3.68, abs=0.2)
    assert values["sticks_at_pct"] == []
    assert "no static friction" in said
    assert "direction bit agreed with the movement in 100.0 %" in said
    assert values["standby_s"] > 2.0 * values["brake_s"]
    for name in result["files"].values():
        assert Path(name).stat().st_size > 1000
    rests = Log.read("out/manual_rests.csv")
    assert {(c3, c4) for c3, c4 in zip(rests.columns["c3"], rests.columns["c4"], strict=True)} == {
        (1.0, 0.0), (1.0, 1.0), (0.0, 0.0),
    }  # fmt: skip


@pytest.mark.long
def test_static_friction_is_seen_in_the_way_up_and_down_and_a_bent_line_is_not_taken_for_it() -> None:
    Path("sticky.toml").write_text(DEFAULT + "\n[effects.static_friction]\nextra_Nm = 0.0111\n")
    result, said = observed("--target", "sim:sticky.toml")
    assert {5.0, -5.0} <= set(result["values"]["sticks_at_pct"])
    assert "static friction above the sliding one" in said
    assert "no static friction" not in said
    result, said = observed("--target", "sim:nxt_fast_decay")
    assert result["values"]["u_plus_pct"] > 45.0  # the bridge is open between its pulses
    assert result["values"]["sticks_at_pct"] == []
    assert "not static friction" in said


def test_a_motor_that_does_not_turn_is_said_so() -> None:
    Path("stuck.toml").write_text(DEFAULT.replace("0.02045", "2.0"))
    done = fiohost("lab", "manual", "--target", "sim:stuck.toml")
    assert done.exit_code == 1
    assert "does not start forward" in done.stderr
