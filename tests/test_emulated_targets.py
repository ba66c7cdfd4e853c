"""Emulated boards as targets: each row of a run within one count of the simulated board's at equal duty steps."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from emulators import BOARDS, DUTY_STEPS, emulator
from places import ROOT

import fiohost
from fiohost.bench.log import Log
from fiohost.bench.seal import is_faulty, is_sealed
from fiohost.cli.main import cli
from fiohost.errors import ConfigError
from fiohost.transport.instruments import Instruments
from firmware_model.emulated import avr

CLOSED = "square_170_190"
EACH = pytest.mark.parametrize("name", BOARDS)


def simulated(name: str, folder: Path) -> str:
    """A target: the simulated board with as many duty steps, speaking framed reports."""
    text = (ROOT / "configs" / "targets" / "sim-framed.toml").read_text(encoding="utf-8")
    path = folder / f"sim-{name}.toml"
    steps = DUTY_STEPS[name.partition("-")[0]]
    path.write_text(text.replace("duty_steps = 3600", f"duty_steps = {steps}"), encoding="utf-8")
    return str(path)


def off_by(a: Log, b: Log) -> tuple[int, int]:
    """The largest difference in counts of all rows, and how many rows differ in their direction bit."""
    assert len(a) == len(b)
    assert np.allclose(a.time_s, b.time_s)
    for column in ("duty_pct", "c3", "c4"):
        assert np.array_equal(a.columns[column], b.columns[column]), column
    turned = (a.columns["pos"] - b.columns["pos"] + 360) % 720 - 360
    return int(np.max(np.abs(turned))), int(np.sum(a.columns["direction"] != b.columns["direction"]))


def both(name: str, folder: Path, experiment: str, plant: str, duty_pct: float = 40.0) -> tuple[int, int, int]:
    logs = []
    for target in (f"emulated:{name}:{plant}", f"{simulated(name, folder)}:{plant}"):
        with fiohost.connect(target) as bench:
            logs.append(bench.run(experiment) if experiment else bench.drive(duty_pct, 20.0))
    return (*off_by(*logs), len(logs[0]))


@EACH
@pytest.mark.parametrize(("experiment", "plant"), [("", "default"), ("", "ideal"), ("random_steps", "default")])
def test_open_loop_rows_are_within_a_count_of_the_simulated_board(
    name: str, experiment: str, plant: str, tmp_path: Path, measured: Callable[[str], None]
) -> None:
    emulator(name)
    counts, directions, rows = both(name, tmp_path, experiment, plant)
    measured(f"{name}, {experiment or 'manual 40 %'}, {plant}: {rows} rows within {counts} count")
    assert rows >= 4000
    assert counts <= 1
    assert directions <= rows // 200  # the bit of the last edge, where one board saw it a row earlier


@pytest.mark.parametrize("name", ["uno-l298n", "bluepill-drv8833"])
def test_other_bridges_drive_the_same_motor_the_same_way(name: str, tmp_path: Path) -> None:
    """The L298N on a plant whose winding is open between pulses, as it leaves it; edges of the PWM resolved."""
    emulator(name.partition("-")[0])
    plant = tmp_path / "resolved.toml"
    kind = "fast_decay = {}" if name.endswith("l298n") else ""
    plant.write_text(
        'schema = "firmware_model.plant/1"\nsupply_V = 9.0\nR_ohm = 5.5\nL_H = 0.015\nKt_Nm_per_A = 0.34\n'
        f'Ke_Vs_per_rad = 0.49\nJ_kgm2 = 3.0e-3\ncoulomb_Nm = 0.02\npwm = "edge_resolved"\n[effects]\n{kind}\n'
    )
    counts, directions, rows = both(name, tmp_path, "", str(plant), -80.0)
    assert rows == 4000
    assert counts <= 1
    assert directions <= 20


@EACH
def test_a_closed_loop_runs_on_machine_code_as_on_the_simulated_board(
    name: str, tmp_path: Path, measured: Callable[[str], None]
) -> None:
    """The loop's own answer to a count is part of the run, so that not the rows but where they go is compared."""
    emulator(name)
    logs = []
    for target in (f"emulated:{name}", simulated(name, tmp_path)):
        with fiohost.connect(target) as bench:
            logs.append(bench.run(CLOSED))
    far = np.max(np.abs(logs[0].output - logs[1].output)) * 2.0  # counts
    measured(f"{name}, {CLOSED}: {len(logs[0])} rows within {far:.0f} count")
    assert len(logs[0]) == len(logs[1]) > 100
    assert far <= 1.0


@EACH
def test_deadband_finds_the_same_edges(name: str, tmp_path: Path) -> None:
    emulator(name)
    found = []
    for target in (f"emulated:{name}", simulated(name, tmp_path)):
        to = tmp_path / "deadband.json"
        words = ["deadband", "--target", target, "--repeats", "1", "--json", str(to), "--force"]
        words += ["--plot", str(tmp_path / "d.png")]
        done = CliRunner().invoke(cli, words)
        assert done.exit_code == 0, done.output
        found.append(json.loads(to.read_text()))
    for key in ("u_plus_pct", "u_minus_pct"):
        values = [one[key]["mean"] if isinstance(one[key], dict) else one[key] for one in found]
        assert values[0] == pytest.approx(values[1], abs=100.0 / DUTY_STEPS[name]), key


@EACH
def test_doctor_recognises_the_board(name: str) -> None:
    emulator(name)
    words = ["doctor", "--target", f"emulated:{name}", "--seconds", "0.2"]
    said = CliRunner().invoke(cli, words).output
    assert f"the board is {name!r}, firmware 0.1.0, bridge tb6612: {DUTY_STEPS[name]} duty steps" in said
    assert "it brakes 100 ms after the last command" in said


def test_a_sealed_plant_shows_nothing_but_its_wire(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    emulator("uno")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with fiohost.connect("emulated:uno:sealed", seed=280) as bench:
        log = bench.drive(50.0, 0.2)
        assert "plant" not in log.metadata
        with pytest.raises(ConfigError, match="sealed"):
            Instruments.of(bench)
    assert is_sealed(log.metadata["target"])
    assert not is_faulty(log.metadata["target"])


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        ("emulated", "needs a board"),
        ("emulated:un", "did you mean 'uno'"),
        ("emulated:uno-l298", "did you mean 'l298n'"),
        ("emulated:uno:nonesuch", "no plant named 'nonesuch'"),
    ],
)
def test_what_cannot_be_emulated_is_refused_in_one_sentence(target: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        fiohost.connect(target)


def test_without_its_emulator_a_board_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "unicorn", None)
    with pytest.raises(ConfigError, match="pip install unicorn"):
        fiohost.connect("emulated:bluepill")
    avr.library.cache_clear()
    monkeypatch.setattr(avr, "kept_in", lambda: str(tmp_path))
    monkeypatch.setattr(avr.shutil, "which", lambda name: None)
    with pytest.raises(ConfigError, match="libsimavr-dev"):
        fiohost.connect("emulated:uno")
    avr.library.cache_clear()
