"""Nothing is lost without a word: what exists, what is read, what another run writes; and only files are read."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from boards import HANG_S, rows_of
from click.testing import CliRunner, Result
from places import PACKAGES, ROOT

from fiohost import files
from fiohost.bench.log import Log, LogWriter
from fiohost.cli.main import cli
from fiohost.errors import ConfigError, FiohostError, LogError

STEP = 'schema = "fiohost.experiment/1"\n[[command]]\nkind = "steps"\ntimes_s = [0.0]\nlevels_pct = [40.0]\n'
STEP += "duration_s = 0.6\n"


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("PYTHONPATH", str(PACKAGES))
    Path("e.toml").write_text(STEP)


def fiohost(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def refused(*arguments: object) -> str:
    result = fiohost(*arguments)
    assert result.exit_code == 1, result.output
    assert len(result.stderr.strip().splitlines()) == 1
    assert "error inside" not in result.stderr
    return result.stderr


def done(*arguments: object) -> None:
    result = fiohost(*arguments)
    assert result.exit_code == 0, result.output


# ---- what exists -----------------------------------------------------------------------------------------------------


def test_a_log_that_exists_is_kept_unless_force_is_given() -> None:
    done("run", "e.toml", "--log", "x.csv")
    before = Path("x.csv").read_bytes()
    assert "it exists; --force overwrites it" in refused("run", "e.toml", "--log", "x.csv")
    assert Path("x.csv").read_bytes() == before
    done("run", "e.toml", "--log", "x.csv", "--force")
    assert Path("x.csv").read_bytes() != before  # another run


def test_names_that_nobody_chose_never_meet() -> None:
    """Four runs in the same second have four logs."""
    command = [sys.executable, "-m", "fiohost", "run", "e.toml"]
    runs = [subprocess.Popen(command, stdout=subprocess.DEVNULL) for _ in range(4)]
    assert [run.wait(HANG_S) for run in runs] == [0] * 4
    logs = list(Path().glob("e-*.csv"))
    assert len(logs) == 4
    assert len({Log.read(log).metadata["run_id"] for log in logs}) == 4


def test_two_runs_on_one_log_are_one_run_and_a_refusal() -> None:
    with files.overwriting():
        first = LogWriter("x.csv", {"target": "one"})
        first.begin(0.0, True)
        with pytest.raises(LogError, match="another run is writing"):
            LogWriter("x.csv", {"target": "two"})
        first.row(0.0, 40.0, 1, 0, 5, 0)
        first.close()
        assert Log.read("x.csv").metadata["target"] == "one"
        LogWriter("x.csv", {"target": "two"}).close()  # the lock went with the run


@pytest.mark.parametrize("command", ["close-loop", "lab"])
def test_a_folder_that_holds_something_is_kept(command: str) -> None:
    Path("out").mkdir()
    Path("out/report.html").write_text("mine")
    arguments = [command, "manual"] if command == "lab" else [command]
    assert "holds something already" in refused(*arguments, "--report", "out")
    assert Path("out/report.html").read_text() == "mine"


def test_results_are_whole_or_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that fills up in the middle leaves what was there before, and nothing of its own."""
    Path("x.json").write_text("before")

    def full(fd: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with files.overwriting(), pytest.raises(FiohostError, match="No space left"):
        files.write_output("x.json", "after")
    assert Path("x.json").read_text() == "before"
    assert sorted(path.name for path in Path().iterdir() if path.is_file()) == ["e.toml", "x.json"]


@pytest.mark.parametrize("kind", ["fifo", "link", "dangling link", "directory"])
def test_what_is_no_ordinary_file_is_not_replaced(kind: str) -> None:
    Path("real.csv").write_text("mine")
    Path("table.csv").write_text("t,u,y\n0,1,2\n1,1,3\n")
    Path("map.toml").write_text(
        'schema = "fiohost.map/1"\n[time]\ncolumn = "t"\n[command]\ncolumn = "u"\n[output]\ncolumn = "y"\n'
        'quantity = "angle"\nunit = "deg"\n'
    )
    make = {
        "fifo": lambda: os.mkfifo("x.csv"),
        "link": lambda: os.symlink("real.csv", "x.csv"),
        "dangling link": lambda: os.symlink("nowhere.csv", "x.csv"),
        "directory": lambda: os.mkdir("x.csv"),
    }
    make[kind]()
    before = os.lstat("x.csv")
    for command in (["import", "table.csv", "--map", "map.toml", "-o"], ["run", "e.toml", "--log"]):
        assert "not an ordinary file" in refused(*command, "x.csv", "--force")
    assert os.lstat("x.csv").st_ino == before.st_ino
    assert Path("real.csv").read_text() == "mine"
    assert not Path("nowhere.csv").exists()


# ---- no output is an input -------------------------------------------------------------------------------------------


def test_no_command_writes_over_what_it_reads() -> None:
    """With --force too, under another name of the same file too."""
    done("run", "e.toml", "--log", "log.csv", "--trace", "wire.jsonl")
    plant = ROOT / "configs/plants/default.toml"
    Path("plant.toml").write_text(plant.read_text())
    Path("model.toml").write_text((ROOT / "configs/models/nxt.toml").read_text())
    Path("map.toml").write_text((ROOT / "configs/maps/nxt_open_loop.toml").read_text())
    os.link("log.csv", "same.csv")
    inputs = ["e.toml", "log.csv", "wire.jsonl", "plant.toml", "model.toml", "map.toml"]
    before = {name: Path(name).read_bytes() for name in inputs}
    for command in (
        ["identify", "log.csv", "--from", "duty", "--json", "log.csv"],
        ["identify", "log.csv", "--from", "duty", "--save-model", "same.csv"],
        ["identify", "log.csv", "--map", "map.toml", "--plot", "map.toml"],
        ["diagnose", "log.csv", "--holdout", "same.csv", "--json", "log.csv"],
        ["diagnose", "log.csv", "--model", "model.toml", "--save-model", "model.toml"],
        ["simulate", "log.csv", "--model", "model.toml", "-o", "model.toml"],
        ["simulate", "log.csv", "--model", "model.toml", "-o", "log.csv"],
        ["design", "--model", "model.toml", "--save", "model.toml"],
        ["run", "e.toml", "--log", "e.toml"],
        ["run", "e.toml", "--log", "./e.toml"],
        ["run", "e.toml", "--target", "sim:plant.toml", "--log", "plant.toml"],
        ["run", "e.toml", "--target", "replay:wire.jsonl", "--log", "wire.jsonl"],
        ["run", "e.toml", "--target", "replay:wire.jsonl", "--trace", "wire.jsonl"],
        ["sniff", "--replay", "wire.jsonl", "--json", "wire.jsonl"],
        ["import", "log.csv", "--map", "map.toml", "-o", "map.toml"],
        ["import", "log.csv", "--map", "map.toml", "-o", "log.csv"],
    ):
        said = refused(*command, "--force")
        assert "this command reads it; give the output another name" in said, command
        assert {name: Path(name).read_bytes() for name in inputs} == before, command


def test_two_outputs_have_two_names() -> None:
    done("run", "e.toml", "--log", "log.csv")
    said = refused("identify", "log.csv", "--from", "duty", "--save-model", "x", "--json", "x")
    assert "cannot write the file x twice" in said


# ---- what is read ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "{}"],
        ["run", "square_170_190", "--controller", "{}"],
        ["run", "e.toml", "--target", "{}"],
        ["run", "e.toml", "--target", "sim:{}"],
        ["run", "e.toml", "--target", "replay:{}"],
        ["run", "square_170_190", "--profile", "{}"],
        ["identify", "{}"],
        ["simulate", "log.csv", "--model", "{}", "-o", "x.csv"],
        ["diagnose", "--readings", "{}"],
        ["import", "{}", "--map", "emps", "-o", "x.csv"],
        ["import", "log.csv", "--map", "{}", "-o", "x.csv"],
        ["unseal", "{}"],
        ["sniff", "--replay", "{}"],
        ["udev", "{}"],
    ],
)  # fmt: skip
def test_devices_pipes_folders_and_loops_are_refused_at_once(arguments: list[str], tmp_path: Path) -> None:
    os.mkfifo("pipe.toml")
    os.mkdir("folder.toml")
    os.symlink("/dev/zero", "zero.toml")
    os.symlink("loop.toml", "loop.toml")
    done("run", "e.toml", "--log", "log.csv")
    for name in ("pipe.toml", "folder.toml", "zero.toml", "loop.toml", "n" * 300 + ".toml", "absent.toml"):
        refused(*(argument.format(f"./{name}") for argument in arguments))


def test_a_file_larger_than_such_a_file_can_be_is_not_read(tmp_path: Path) -> None:
    with open("large.toml", "wb") as large:
        large.truncate(20_000_000_000)  # sparse
    for command in (
        ["run", "large.toml"],
        ["run", "e.toml", "--target", "sim:./large.toml"],
        ["identify", "large.toml"],
        ["diagnose", "--readings", "large.toml"],
    ):
        assert "larger than" in refused(*command)


def test_a_name_plays_no_tricks_with_the_terminal() -> None:
    said = refused("identify", "\x1b[2Jgone\x07\u202eslice")
    assert "\\x1b[2Jgone\\x07\\x202eslice" in said
    assert "\x1b" not in said
    assert len(refused("run", "x" * 5000)) < 1000


def test_what_cannot_be_read_is_exit_1(monkeypatch: pytest.MonkeyPatch) -> None:
    done("run", "e.toml", "--log", "log.csv")
    real = os.open

    def forbidden(path: object, flags: int, *more: int) -> int:
        if str(path) == "log.csv":
            raise PermissionError(13, "Permission denied")
        return real(path, flags, *more)  # type: ignore[call-overload, no-any-return]

    monkeypatch.setattr(os, "open", forbidden)
    monkeypatch.setattr(os, "access", lambda path, mode, **more: str(path) != "log.csv")
    assert "cannot read the log log.csv: Permission denied" in refused("identify", "log.csv")


@pytest.mark.parametrize(
    ("name", "text", "command", "said"),
    [
        (
            "map.yaml",
            "time: a\n",
            ["import", "log.csv", "--map", "map.yaml", "-o", "o.csv"],
            "map.yaml is not valid TOML",
        ),
        ("m.toml", "", ["simulate", "log.csv", "--model", "m.toml", "-o", "o.csv"], "is empty"),
        ("p.toml", None, ["run", "e.toml", "--target", "sim:./p.toml"], "beyond what any motor has"),
        ("r.toml", None, ["diagnose", "--readings", "r.toml"], "is not a number within 1e+09"),
    ],
)
def test_numbers_and_files_that_make_no_sense_are_refused(
    name: str, text: str | None, command: list[str], said: str
) -> None:
    done("run", "e.toml", "--log", "log.csv")
    plant = (ROOT / "configs/plants/default.toml").read_text()
    page = (ROOT / "docs/readings.md").read_text()
    readings = page.partition("```toml\n")[2].partition("```")[0].replace("kp = 1.5", "kp = 1e308")
    Path(name).write_text(
        text if text is not None else {"p.toml": plant + "\n[effects.constant_load]\ntorque_Nm = 1e18\n",
                                       "r.toml": readings}[name]
    )  # fmt: skip
    assert said in refused(*command)


def test_long_values_are_cut_in_messages() -> None:
    Path("long.toml").write_text(f'schema = "{"x" * 100_000}"\n')
    assert len(refused("run", "long.toml")) < 2000


def test_umlauts_in_a_locale_without_them_end_no_command() -> None:
    Path("e.toml").rename("Schlüssel-☃.toml")
    environment = {**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C", "PYTHONUTF8": "0"}
    command = [sys.executable, "-m", "fiohost", "run", "Schlüssel-☃.toml", "--log", "Prüf.csv", "--json", "-"]
    said = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert said.returncode == 0, said.stderr
    assert json.loads(said.stdout)["log"] == "Prüf.csv"
    assert b"Traceback" not in said.stderr
    command = [sys.executable, "-m", "fiohost", "identify", "Prüf.csv", "--from", "duty", "--json", "-"]
    said = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert list(json.loads(said.stdout)["used"]) == ["Prüf.csv"]


def test_a_name_with_dollar_signs_is_drawn_as_it_is() -> None:
    done("run", "e.toml", "--log", "$x^$.csv")
    done("identify", "$x^$.csv", "--from", "duty", "--plot", "p.png")
    assert Path("p.png").stat().st_size > 5000


def test_identify_and_simulate_say_what_they_left_out() -> None:
    done("run", "e.toml", "--log", "log.csv")
    lines = Path("log.csv").read_text().splitlines(keepends=True)
    Path("torn.csv").write_text("".join(lines[:-4]) + "0.29,40")
    for command in (
        ["identify", "torn.csv", "--from", "duty"],
        ["simulate", "torn.csv", "--model", "linear", "-o", "out.csv"],
    ):
        result = fiohost(*command)
        assert result.exit_code == 0, result.output
        assert "the last line, which is cut off in its middle" in result.stdout


def test_identify_takes_stretches_of_a_very_long_log_from_all_of_it_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A motor whose gain falls by a third in mid-log: its first rows alone would know nothing of it."""
    monkeypatch.setattr("fiohost.cli.identify.MOST_ROWS", 2000)
    rng = np.random.default_rng(1)
    duty = np.repeat(rng.uniform(-60.0, 60.0, 120), 100)
    speed, rows = 0.0, []
    for k, u in enumerate(duty):
        rows.append(f"{0.005 * k:.3f},{u:.2f},{speed:.4f}")
        speed += (1.0 - math.exp(-0.005 / 0.08)) * ((9.0 if k < 6000 else 6.0) * round(u, 2) - speed)
    head = "# schema: fiohost.log/1\n# sample_time_s: 0.005\n# begins: at rest\ntime_s,duty_pct,speed_deg_s\n"
    Path("long.csv").write_text(head + "\n".join(rows) + "\n")
    result = fiohost("identify", "long.csv", "--json", "found.json")
    assert result.exit_code == 0, result.output
    assert "all but 10 stretches of 200 rows, spread evenly over its 12000 rows" in result.stdout
    told = json.loads(Path("found.json").read_text())
    assert told["used"] == {"long.csv": {"rows": 12000, "rows_fitted": 2000}}
    assert told["logs"] == ["long.csv"]
    assert any("10 stretches" in note for note in told["dropped"]["long.csv"])
    assert 6.9 < told["parameters"]["gain_deg_s_per_pct"]["value"] < 8.1


def test_a_stretch_whose_duty_is_at_its_limit_throughout_is_left_out_with_a_note(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done("run", "square_170_190", "--log", "log.csv")
    monkeypatch.setattr("fiohost.cli.identify.MOST_ROWS", 3000)
    monkeypatch.setattr("fiohost.cli.identify.STRETCHES", 2)
    lines = Path("log.csv").read_text().splitlines(keepends=True)
    at = next(k for k, line in enumerate(lines) if line.startswith("time_s")) + 1
    full = [line.split(",") for line in lines[at : at + 1500]]
    lines[at : at + 1500] = [",".join([fields[0], "100", *fields[2:]]) for fields in full]
    Path("full.csv").write_text("".join(line for line in lines if not line.startswith("# end:")))
    result = fiohost("identify", "full.csv")
    assert result.exit_code == 0, result.output
    assert "left out, 1 of 2 records: full.csv: the duty is at its limit" in result.stdout


def test_names_of_a_foreign_table_are_cut_in_what_is_said_and_shown_escaped() -> None:
    long = "c" * 60_000
    rows = "".join(
        f"{0.01 * k:.2f},{30 * math.sin(k / 20):.3f},{90 * math.sin(k / 20 - 0.3):.3f},{k}\n" for k in range(600)
    )
    for name, most in ((long, 3000), ("x\x1b[31my", 1500)):
        Path("t.csv").write_text(f"time (s),duty (%),speed (deg/s),{name}\n{rows}")
        result = fiohost("import", "t.csv", "-o", "o.csv", "--force")
        assert result.exit_code == 0, result.output
        assert "not used: " in result.output
        assert len(result.stdout) < most
        assert "\x1b" not in result.stdout
        assert len(Log.read("o.csv")) == 600  # the head of what was made can be read
        refused("import", "t.csv", "--measured", long, "-o", "o.csv", "--force")


def test_a_long_argument_is_cut_where_the_syntax_is_wrong() -> None:
    long = "n" * 60_000
    for words in (["plants", long], ["run", f"--{long}"], [long], ["manual", "--pwm", "1", f"--{long}=2"]):
        result = fiohost(*words)
        assert result.exit_code == 2
        assert len(result.output) < 3000


def test_an_output_of_one_run_may_be_read_by_the_same_command() -> None:
    with files.command():
        writer = LogWriter("x.csv", {"counts_per_rev": "720", "sample_time_s": "0.005"})
        writer.row(0.0, 40.0, 1, 0, 5, 0)
        writer.close()
        assert len(Log.read("x.csv")) == 1
        with pytest.raises(FiohostError, match="this command reads it"), files.overwriting():
            files.claim("x.csv")
    assert len(rows_of(Path("x.csv"))) == 1
    with pytest.raises(ConfigError, match="cannot read the thing"):
        files.read_input(".", 10, "the thing", ConfigError)
