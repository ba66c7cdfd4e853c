"""The whole circle on machine code: a sealed plant behind an emulated Uno, and the effect is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from emulators import emulator

from fiohost.cli.main import cli

SEED, EFFECT = 280, "gravity_load"


@pytest.mark.long
def test_close_loop_on_an_emulated_uno_names_the_effect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, measured: Callable[[str], None]
) -> None:
    emulator("uno")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    to, report = tmp_path / "circle.json", tmp_path / "report"
    words = ["close-loop", "--target", "emulated:uno:sealed", "--seed", str(SEED), "--no-follow-up"]
    done = CliRunner().invoke(cli, [*words, "--report", str(report), "--json", str(to)])
    assert done.exit_code == 0, done.output
    result = json.loads(to.read_text())
    named = [step["effect"] for step in result["diagnosis"]["steps"]]
    measured(f"uno: close-loop on the sealed plant {SEED} names {', '.join(named)}")
    assert named == [EFFECT]
    assert result["diagnosis"]["verdict"] == "explained"
    assert "supply_V" not in (report / "staircase.csv").read_text().partition("time_s")[0]
