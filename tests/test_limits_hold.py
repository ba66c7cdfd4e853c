"""The limits of a target hold in every command that drives: seen in what crossed the wire."""

from __future__ import annotations

import json
import struct
from itertools import pairwise
from pathlib import Path

import pytest
from click.testing import CliRunner

from fiohost.bench.unwrap import Unwrapper
from fiohost.cli.main import cli

COMMANDS = [
    ["manual", "--pwm", "40", "--duration", "5", "--fast"],
    ["run", "staircase"],
    ["deadband"],
    ["deadband", "--method", "steps"],
    ["close-loop"],
    ["lab", "manual"],
    ["lab", "elevator"],
    ["lab", "precompensation"],
    ["lab", "identification"],
    ["lab", "design"],
    ["lab", "characterise"],
]
# of a run; the shaft may turn on for a moment before the brake holds it
DUTY_PCT, TRAVEL_DEG, RUN_TIME_S, SLEW_PCT_PER_S = 3.0, 60.0, 0.8, 50.0
RUN_ON_DEG = 30.0
STEP_S = 0.005
BRAKE = (0.0, 1, 1)


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


def driven(trace: Path) -> list[list[tuple[float, float, float]]]:
    """Stretches between brakes: (time, signed duty, angle), each from the last brake before it on."""
    stretches: list[list[tuple[float, float, float]]] = []
    row, unwrap, drives = (0.0, 0.0, 0.0), Unwrapper(720).update, False
    angle_deg = 0.0
    for text in trace.read_text().splitlines()[1:]:
        event = json.loads(text)
        if event.get("dir") == "in":
            angle_deg = unwrap(int.from_bytes(bytes.fromhex(event["hex"]).ljust(3, b"\0")[1:3], "little")) / 2
        elif event.get("dir") == "out":
            duty_pct, c3, c4 = struct.unpack("<fBB", bytes.fromhex(event["hex"]).ljust(6, b"\0")[:6])
            before, row = row, (event["t"], duty_pct if c3 else -duty_pct, angle_deg)
            if (duty_pct, c3, c4) == BRAKE:
                drives = False
                continue
            if not drives:
                stretches.append([before])
            drives = True
            stretches[-1].append(row)
    assert not drives, "the last command is no brake"
    return stretches


def stopped_by(*arguments: str) -> tuple[str, list[list[tuple[float, float, float]]]]:
    result = CliRunner().invoke(cli, [*arguments, "--trace", "trace"])
    assert result.exit_code in (0, 1), result.output
    return result.stderr, driven(Path("trace"))


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_no_command_drives_beyond_the_limit_of_duty(command: list[str]) -> None:
    said, stretches = stopped_by(*command, "--limit", f"duty_pct={DUTY_PCT}")
    assert all(abs(duty) <= DUTY_PCT for stretch in stretches for _, duty, _ in stretch)
    assert f"limit of {DUTY_PCT:g} %" in said or f"up to {DUTY_PCT:g} %" in said


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_no_command_turns_the_shaft_beyond_the_limit_of_travel(command: list[str]) -> None:
    said, stretches = stopped_by(*command, "--limit", f"travel_deg={TRAVEL_DEG}")
    assert stretches
    for stretch in stretches:
        assert max(abs(angle - stretch[0][2]) for _, _, angle in stretch) <= TRAVEL_DEG + RUN_ON_DEG
    assert f"travel limit of {TRAVEL_DEG:g} deg: braked" in said


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_no_run_of_a_command_lasts_longer_than_the_limit(command: list[str]) -> None:
    said, stretches = stopped_by(*command, "--limit", f"run_time_s={RUN_TIME_S}")
    for stretch in stretches:
        assert stretch[-1][0] - stretch[0][0] <= RUN_TIME_S + STEP_S
    assert f"limit of {RUN_TIME_S:g} s: braked" in said


@pytest.mark.parametrize("command", COMMANDS[:4], ids=" ".join)
def test_the_duty_changes_no_faster_than_the_limit(command: list[str]) -> None:
    _, stretches = stopped_by(*command, "--limit", f"slew_pct_per_s={SLEW_PCT_PER_S}")
    assert stretches
    for stretch in stretches:
        for (t, duty, _), (t_next, duty_next, _) in pairwise(stretch):
            assert abs(duty_next - duty) <= SLEW_PCT_PER_S * (t_next - t) + 1e-3
