"""The commands that drive: what people see, what they may ask for, and how they end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from boards import HANG_S, rows_of
from click.testing import CliRunner, Result
from places import PACKAGES, ROOT

from fiohost.bench.log import Log
from fiohost.cli.main import COMMANDS, cli

FIOHOST = [sys.executable, "-m", "fiohost"]


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands write into the current folder, and seals into the user's state: give each test its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("PYTHONPATH", str(PACKAGES))


def fiohost(*arguments: str) -> Result:
    return CliRunner().invoke(cli, list(arguments))


def refused(*arguments: str) -> str:
    """The sentence with which a command is refused."""
    result = fiohost(*arguments)
    assert result.exit_code == 1, result.output
    assert result.stdout == ""
    sentences = result.stderr.strip().splitlines()
    assert len(sentences) == 1
    assert sentences[0].startswith("fiohost: ")
    return sentences[0]


# ---- the command itself --------------------------------------------------------------------------------------------


def test_help_lists_every_command_without_loading_one_nor_numpy() -> None:
    code = (
        "import sys; from fiohost.cli.main import cli\n"
        "try: cli(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {m.split('.')[0] for m in sys.modules} & {'numpy', 'scipy', 'matplotlib', 'numba', 'rich', 'jinja2'}\n"
        "loaded = [m for m in sys.modules if m.startswith(('fiohost.', 'firmware_model'))]\n"
        "print(sorted(heavy), sorted(loaded))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for name, (_, summary) in COMMANDS.items():
        assert name in done.stdout
        assert summary.split(".")[0] in done.stdout
    light = ["fiohost.cli", "fiohost.cli.lazy", "fiohost.cli.main", "fiohost.errors"]
    assert done.stdout.splitlines()[-1] == f"[] {light}"


@pytest.mark.parametrize("name", list(COMMANDS))
def test_every_command_of_the_table_is_there_and_gives_an_example(name: str) -> None:
    result = fiohost(name, "--help")
    assert result.exit_code == 0, result.output
    assert f"fiohost {name}" in result.stdout.split("Example", 1)[1]


@pytest.mark.long
def test_verbose_and_debug_are_taken_before_and_after_the_command() -> None:
    for arguments in (["-v", "run", "sine_slow"], ["run", "sine_slow", "-v"]):
        done = subprocess.run([*FIOHOST, *arguments], capture_output=True, text=True, check=True)
        assert "opened sim: simulated, profile hid-assumed (layout assumed)" in done.stderr
    done = subprocess.run([*FIOHOST, "manual", "--pwm", "5", "--duration", "0.02", "--fast", "--debug"],
                          capture_output=True, text=True, check=True)  # fmt: skip
    assert "out  64: 00 00 a0 40 01" in done.stderr


def test_wrong_syntax_is_exit_2() -> None:
    for arguments in (["manul"], ["manual"], ["manual", "--pwm"], ["manual", "--pmw", "4"], ["run"], ["unseal"]):
        assert fiohost(*arguments).exit_code == 2


def test_the_version_is_told() -> None:
    from fiohost import __version__

    assert __version__ in fiohost("--version").stdout


# ---- manual --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "bits", "mode", "sense"),
    [
        (["--pwm", "40"], (1, 0), "drive", 1),
        (["--pwm", "-40"], (0, 1), "drive", -1),
        (["--pwm", "0"], (1, 1), "brake", 0),
        (["--standby"], (0, 0), "standby", 0),
    ],
)
def test_manual_shows_each_second_what_is_sent_and_what_the_shaft_does(
    arguments: list[str], bits: tuple[int, int], mode: str, sense: int
) -> None:
    result = fiohost("manual", *arguments, "--duration", "3", "--fast", "--json", "out.json", "--log", "out.csv")
    assert result.exit_code == 0, result.output
    lines = [line.split() for line in result.stdout.splitlines() if "deg/s" in line]
    assert [float(line[0]) for line in lines[:3]] == [0.0, 1.0, 2.0]
    for word in ("C3", "C4", "POS", "angle", "direction", "speed", "duty"):
        assert word in result.stdout
    for line in lines:
        assert (int(line[3]), int(line[4]), line[5]) == (*bits, mode)
    samples = json.loads(Path("out.json").read_text())["samples"]
    for sample in samples:
        assert (sample["c3"], sample["c4"], sample["mode"]) == (*bits, mode)
        assert sample["angle_display_deg"] == (sample["pos"] + 1) / 2
    assert np.sign(samples[-1]["speed_deg_s"]) == sense
    if sense:
        assert samples[-1]["direction"] == (0 if sense > 0 else 1)
        assert 350 < abs(samples[-1]["speed_deg_s"]) < 420  # (40 - 3.7) % at 10.6 deg/s per %
    log = Log.read("out.csv")
    assert len(log) == 600
    assert set(log.duty_pct) == {40.0 * sense}
    assert (set(log.columns["c3"]), set(log.columns["c4"])) == ({bits[0]}, {bits[1]})


@pytest.mark.parametrize("pwm", ["100.1", "-250", "nan", "inf", "forty", "", "1e999", "40%"])
def test_a_duty_beyond_100_or_nan_or_text_is_refused_in_one_sentence(pwm: str) -> None:
    assert "within -100 to 100 percent" in refused("manual", "--pwm", pwm, "--log", "never.csv")
    assert not Path("never.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--pwm", "10", "--duration", "0"], "--duration"),
        (["--pwm", "10", "--duration", "soon"], "--duration"),
        (["--pwm", "10", "--duration", "nan"], "--duration"),
        (["--pwm", "10", "--fast"], "never end"),
        (["--pwm", "10", "--seed", "-1"], "--seed"),
        (["--pwm", "10", "--target", "nowhere"], "unknown target"),
        (["--pwm", "10", "--target", "sim:nowhere"], "nowhere"),
        (["--pwm", "10", "--json", "no/folder/x.json"], "no folder"),
    ],
)
def test_other_values_that_make_no_sense_are_refused_too(arguments: list[str], reason: str) -> None:
    assert reason in refused("manual", *arguments)


def test_an_unwritable_log_stops_before_anything_is_driven() -> None:
    result = fiohost("manual", "--pwm", "40", "--duration", "1", "--fast", "--log", "no/folder/x.csv")
    assert result.exit_code == 1
    assert "cannot write the log no/folder/x.csv" in result.stderr
    assert "deg/s" not in result.stdout


def start(*arguments: str, **more: Any) -> subprocess.Popen[str]:
    return subprocess.Popen([*FIOHOST, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more)


def wait_for_rows(path: Path, count: int) -> None:
    deadline = time.monotonic() + HANG_S
    while not path.exists() or len(rows_of(path)) < count:
        assert time.monotonic() < deadline, "the command did not begin"
        time.sleep(0.02)


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_manual_brakes_and_ends_on_ctrl_c_and_its_kin_with_the_log_whole(name: str, code: int) -> None:
    log_path = Path("run.csv")
    command = start("--debug", "manual", "--pwm", "40", "--log", str(log_path), "--json", "out.json")
    wait_for_rows(log_path, 50)
    command.send_signal(getattr(signal, name))
    _, errors = command.communicate(timeout=HANG_S)
    assert command.returncode == code, errors
    sent = [line.partition("64: ")[2] for line in errors.splitlines() if line.startswith("fiohost.traffic: out")]
    last_drive = max(i for i, report in enumerate(sent) if report == "00 00 20 42 01")
    assert len(sent) > last_drive + 1
    assert set(sent[last_drive + 1 :]) == {"00 00 00 00 01 01"}  # nothing but brakes has left since
    log = Log.read(log_path)
    assert len(log) >= 50
    assert log.dropped == ()
    assert log.metadata["ending"].startswith("stopped by")
    assert f"the log run.csv is closed with its {len(log)} rows" in errors
    assert "Traceback" not in errors
    assert json.loads(Path("out.json").read_text())["ended"].startswith("stopped by")


def test_manual_keeps_real_time() -> None:
    begin = time.monotonic()
    result = fiohost("manual", "--pwm", "20", "--duration", "1.2")
    assert result.exit_code == 0
    assert time.monotonic() - begin >= 1.2


def test_a_reader_who_leaves_ends_the_run_without_a_traceback() -> None:
    command = start("manual", "--pwm", "40", "--log", "run.csv")
    assert command.stdout is not None
    while "deg/s" not in command.stdout.readline():
        pass
    command.stdout.close()
    assert command.wait(timeout=HANG_S) == 1
    assert command.stderr is not None
    assert "Traceback" not in command.stderr.read()
    assert "BrokenPipe" in Log.read("run.csv").metadata["ending"]


# ---- deadband ------------------------------------------------------------------------------------------------------


def test_the_deadband_of_the_default_plant_is_its_dry_friction_in_both_directions() -> None:
    result = fiohost("deadband", "--repeats", "3", "--plot", "db.png", "--json", "db.json")
    assert result.exit_code == 0, result.output
    found = json.loads(Path("db.json").read_text())
    # 0.02045 N m on 0.3408 N m/A and 9 V over 5.515 ohm: 3.68 % of full duty
    assert found["u_plus_pct"] == pytest.approx(3.68, abs=0.25)
    assert found["u_minus_pct"] == pytest.approx(-3.68, abs=0.25)
    assert 0.0 <= found["u_plus_spread_pct"] < 0.3
    assert len(found["repeats"]) == 6
    angles = [r["at_angle_deg"] for r in found["repeats"] if r["direction"] == "forward"]
    assert np.ptp(angles) > 60  # the repeats start at different places of the turn
    assert Path("db.png").read_bytes()[:4] == b"\x89PNG"
    for word in ("u_plus", "u_minus", "spread"):
        assert word in result.stdout


def test_a_load_that_pushes_one_way_shows_as_two_different_deadbands() -> None:
    plant = (ROOT / "configs" / "plants" / "default.toml").read_text()
    Path("loaded.toml").write_text(plant + "\n[effects.constant_load]\ntorque_Nm = 0.00556\n")  # 1 % of full duty
    result = fiohost("deadband", "--target", "sim:loaded.toml", "--repeats", "2", "--json", "db.json")
    assert result.exit_code == 0, result.output
    found = json.loads(Path("db.json").read_text())
    assert found["u_plus_pct"] == pytest.approx(4.68, abs=0.25)
    assert found["u_minus_pct"] == pytest.approx(-2.68, abs=0.25)


def test_a_weight_that_makes_the_start_depend_on_the_angle_is_noted() -> None:
    plant = (ROOT / "configs" / "plants" / "default.toml").read_text()
    Path("weight.toml").write_text(plant + "\n[effects.gravity_load]\ntorque_Nm = 0.01\nphase_rad = 0.0\n")
    result = fiohost("deadband", "--target", "sim:weight.toml", "--json", "db.json")
    assert result.exit_code == 0, result.output
    assert "differs between places of the turn" in result.stdout
    assert json.loads(Path("db.json").read_text())["u_plus_spread_pct"] > 0.5


def test_a_motor_that_does_not_start_is_said_so_with_what_to_look_at() -> None:
    plant = (ROOT / "configs" / "plants" / "default.toml").read_text().replace("0.02045", "0.4")
    Path("stuck.toml").write_text(plant)
    result = fiohost("deadband", "--target", "sim:stuck.toml", "--max", "60")
    assert result.exit_code == 1
    assert "does not start forward up to 60 %" in result.stderr
    assert "pull-ups" in result.stderr


@pytest.mark.parametrize(
    ("option", "value", "reason"),
    [("--repeats", "0", "--repeats"), ("--repeats", "many", "--repeats"), ("--max", "101", "--max"),
     ("--plot", "no/x.png", "no folder"), ("--plot", ".", "is a directory")],
)  # fmt: skip
def test_a_sweep_that_makes_no_sense_is_refused(option: str, value: str, reason: str) -> None:
    assert reason in refused("deadband", option, value)


# ---- run -----------------------------------------------------------------------------------------------------------


def test_run_makes_a_log_and_says_what_happened() -> None:
    result = fiohost("run", "square_170_190", "--log", "run.csv", "--json", "run.json")
    assert result.exit_code == 0, result.output
    assert "ticks" in result.stdout
    log = Log.read("run.csv")
    assert (log.metadata["experiment"], log.metadata["loop"], log.metadata["controller"]) == (
        "square_170_190", "closed", "p",
    )  # fmt: skip
    assert (log.sample_time_s, len(log)) == (0.005, 6000)
    edges = np.flatnonzero(np.diff(log.columns["ref_deg"])) + 1
    np.testing.assert_array_equal(edges, 600 * np.arange(1, 10))
    assert set(log.columns["ref_deg"]) == {170.0, 190.0}
    told = json.loads(Path("run.json").read_text())
    assert (told["rows"], told["sha256"], told["log"]) == (6000, log.sha256, "run.csv")


@pytest.mark.parametrize("name", ["staircase", "multisine", "random_steps", "pulses", "sine_slow"])
def test_the_open_loop_experiments_run_from_any_folder(name: str) -> None:
    result = fiohost("run", name, "--log", "run.csv")
    assert result.exit_code == 0, result.output
    log = Log.read("run.csv")
    assert np.all(np.isnan(log.columns["ref_deg"]))
    assert np.ptp(log.duty_pct) > 30
    assert np.ptp(log.output) > 20


def test_without_log_a_file_named_after_the_experiment_is_written_here() -> None:
    result = fiohost("run", "sine_slow", "--json", "-")
    assert result.exit_code == 0
    told = json.loads(result.stdout)  # standard output holds the JSON and nothing else
    assert Path(told["log"]).is_file()
    assert told["log"].startswith("sine_slow-")
    assert "ticks" in result.stderr


def test_a_file_of_ones_own_can_be_run_and_a_wrong_one_is_refused() -> None:
    text = '[[command]]\nkind = "constant"\nlevel_pct = 30.0\nduration_s = 0.5\n'
    Path("mine.toml").write_text(text)
    assert fiohost("run", "mine.toml", "--log", "mine.csv").exit_code == 0
    assert len(Log.read("mine.csv")) == 100
    Path("wrong.toml").write_text(text.replace("level_pct", "level"))
    assert "wrong.toml" in refused("run", "wrong.toml")
    assert "did you mean 'multisine'" in refused("run", "multisin")


def test_run_lists_what_there_is() -> None:
    result = fiohost("run", "--list", "--json", "-")
    names = [e["name"] for e in json.loads(result.stdout)["experiments"]]
    assert {"square_170_190", "staircase", "multisine", "random_steps", "pulses", "sine_slow"} <= set(names)


def test_a_run_in_real_time_can_be_stopped_and_says_that_its_log_is_whole() -> None:
    command = start("run", "staircase", "--realtime", "--log", "run.csv")
    wait_for_rows(Path("run.csv"), 20)
    command.send_signal(signal.SIGINT)
    _, errors = command.communicate(timeout=HANG_S)
    assert command.returncode == 130
    log = Log.read("run.csv")
    assert f"closed with its {len(log)} rows" in errors
    assert log.metadata["ending"] == "stopped by Ctrl-C"


# ---- plants and seals ----------------------------------------------------------------------------------------------


def test_plants_are_listed_with_their_source() -> None:
    result = fiohost("plants", "--json", "plants.json")
    told = json.loads(Path("plants.json").read_text())
    assert told["default"] in [p["name"] for p in told["plants"]]
    for plant in told["plants"]:
        assert plant["source"]
        assert f"sim:{plant['name']}" in result.stdout


def test_a_sealed_log_is_opened_by_its_file_or_by_its_seed() -> None:
    assert fiohost("run", "sine_slow", "--target", "sim:sealed", "--seed", "77", "--log", "s.csv").exit_code == 0
    by_log, by_seed = fiohost("unseal", "s.csv"), fiohost("unseal", "77")
    assert by_log.exit_code == by_seed.exit_code == 0
    assert by_log.stdout == by_seed.stdout
    assert fiohost("run", "sine_slow", "--target", "sim:sealed", "--log", "d.csv").exit_code == 0
    assert fiohost("unseal", "d.csv").exit_code == 0
    assert "not sealed" in refused("unseal", _open_log())
    assert "neither a seed" in refused("unseal", "absent.csv")
    Path("empty.csv").write_text("")
    assert "empty" in refused("unseal", "empty.csv")


def _open_log() -> str:
    assert fiohost("run", "sine_slow", "--log", "open.csv").exit_code == 0
    return "open.csv"


def test_without_a_place_for_the_seal_a_sealed_run_is_refused() -> None:
    Path("state").write_text("a file where the folder should be")
    assert "XDG_STATE_HOME" in refused("run", "sine_slow", "--target", "sim:sealed", "--log", "s.csv")
    assert os.path.exists("state")
