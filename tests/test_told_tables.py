"""What is said of foreign tables on the command line holds for all of them, and tables of a bench are read as one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

import fiohost
from fiohost.bench.log import Log
from fiohost.circle.evidence import diagnose
from fiohost.cli.main import cli
from fiohost.errors import ConfigError, DataError
from fiohost.importing.automatic import read_any

TURN_COUNTS = 1000


class EnoughRead(Exception):
    """Raised once logs are read, before anything is fitted."""


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def counted(path: Path, level: float, rows: int = 60) -> Path:
    path.write_text("t [s],duty [%],counts\n" + "".join(f"{i / 100},{level},{i * i}\n" for i in range(rows)))
    return path


def in_volts(path: Path, most: float, step: float = 7.3) -> Path:
    rows = (f"{i / 100},{most * (i % 5) / 4},{(step * i) % 360:.2f}\n" for i in range(90))
    path.write_text("t [s],u [V],angle [deg]\n" + "".join(rows))
    return path


def test_a_held_out_table_has_the_full_scale_of_those_that_are_fitted(tmp_path: Path) -> None:
    train, held = in_volts(tmp_path / "a.csv", 21.0), in_volts(tmp_path / "b.csv", 17.0)
    read: list[Log] = []

    def announced(train: Sequence[Log], held: Sequence[Log]) -> None:
        read.extend((*train, *held))
        raise EnoughRead

    with pytest.raises(EnoughRead):
        diagnose([train], [held], announce=announced)
    assert [log.metadata["full_scale"] for log in read] == ["24", "24"]
    assert read_any([held])[0].metadata["full_scale"] == "18"


def test_a_command_has_one_full_scale_though_other_columns_differ(tmp_path: Path) -> None:
    far, near = in_volts(tmp_path / "a.csv", 21.0), in_volts(tmp_path / "b.csv", 17.0)
    head, *rows = near.read_text().splitlines()
    near.write_text("\n".join([f"{head},temperature [C]", *(f"{row},20" for row in rows)]) + "\n")
    assert [log.metadata["full_scale"] for log in read_any([far, near])] == ["24", "24"]


def test_what_one_table_does_not_show_of_the_sensor_another_does(tmp_path: Path) -> None:
    around, within = in_volts(tmp_path / "a.csv", 12.0), in_volts(tmp_path / "b.csv", 12.0, step=0.0)
    within.write_text("t [s],u [V],angle [deg]\n" + "".join(f"{i / 100},3,{40 * (i % 2)}\n" for i in range(90)))
    one, other = read_any([around, within])
    assert "wraps at 360 deg" in one.metadata["understood"]
    assert "wraps at 360 deg" in other.metadata["understood"]
    assert one.output_quantum == other.output_quantum
    assert read_any([within])[0].output_quantum == pytest.approx(40.0)


@pytest.mark.parametrize("command", ["plot", "identify", "diagnose"])
def test_what_is_unknown_is_said_to_the_command_itself(command: str, tmp_path: Path) -> None:
    table = counted(tmp_path / "run.csv", 40.0)
    refused = call(command, table)
    assert refused.exit_code == 1
    assert "say it with --counts-per-rev" in refused.stderr
    output = ("-o", tmp_path / "run.png") if command == "plot" else ()
    done = call(command, table, "--counts-per-rev", TURN_COUNTS, *output)
    assert "--counts-per-rev" not in done.stderr
    assert done.exit_code == 0 or command != "plot", done.stderr


def test_a_simulation_takes_a_table_as_it_is_told(tmp_path: Path) -> None:
    table, out = counted(tmp_path / "run.csv", 40.0), tmp_path / "out.csv"
    done = call("simulate", table, "--model", "linear", "--counts-per-rev", TURN_COUNTS, "-o", out)
    assert done.exit_code == 0, done.stderr
    assert out.exists()


def test_a_fleet_is_told_of_its_tables_once(tmp_path: Path) -> None:
    folder = tmp_path / "line"
    folder.mkdir()
    for name in ("a", "b"):
        counted(folder / f"{name}.csv", 40.0)
    refused = call("fleet", folder, "--out", tmp_path / "none", "--fit-only", "--processes", 1)
    assert "say it with --counts-per-rev" in refused.stdout
    told = call("fleet", folder, "--out", tmp_path / "out", "--fit-only", "--processes", 1, "--counts-per-rev", "1000")
    assert "--counts-per-rev" not in told.stdout


@pytest.mark.parametrize("command", ["plot", "identify", "diagnose", "import"])
def test_an_answer_beside_a_map_and_one_that_is_no_number_are_refused(command: str, tmp_path: Path) -> None:
    table = counted(tmp_path / "run.csv", 40.0)
    both = call(command, table, "--map", "nxt_open_loop", "--full-scale", "5")
    assert (both.exit_code, "leave the map away" in both.stderr) == (1, True)
    wrong = call(command, table, "--counts-per-rev", "many")
    assert (wrong.exit_code, "--counts-per-rev 'many' is not a number" in wrong.stderr) == (1, True)


def test_readings_refuse_what_is_said_of_tables_by_its_name(tmp_path: Path) -> None:
    refused = call("diagnose", "--readings", tmp_path / "r.toml", "--full-scale", "3")
    assert refused.exit_code == 1
    assert "--full-scale does not go with --readings" in refused.stderr


def test_of_a_log_that_says_what_it_is_nothing_is_to_be_told(tmp_path: Path) -> None:
    log = tmp_path / "run.csv"
    log.write_text("# schema: fiohost.log/1\ntime_s,duty_pct,angle_deg\n0,1,0\n0.1,1,0\n0.2,1,0\n")
    refused = call("plot", log, "--full-scale", "24")
    assert refused.exit_code == 1
    assert "is a log of fiohost" in refused.stderr
    with pytest.raises(ConfigError, match="says itself what it is"):
        fiohost.read_log(log, counts_per_rev=4)


def test_python_says_the_same_of_one_table_or_several(tmp_path: Path) -> None:
    tables = [counted(tmp_path / f"{n}.csv", 40.0) for n in "ab"]
    for log in (fiohost.read_log(tables[0], counts_per_rev=1000), *fiohost.read_logs(tables, counts_per_rev=1000)):
        assert log.output_name == "angle_deg"
        assert log.output_quantum == pytest.approx(0.36)
        assert log.metadata["counts_per_rev"] == "1000"


@pytest.mark.parametrize(("most", "steps"), [(160, 255), (255, 255), (700, 1023), (1500, 4095), (20_000, 65_535)])
def test_pwm_steps_are_of_the_register_that_they_fill(tmp_path: Path, most: int, steps: int) -> None:
    path = in_volts(tmp_path / "a.csv", 4.0 * (most // 4))
    path.write_text(path.read_text().replace("u [V]", "pwm").replace(".0,", ","))
    assert float(read_any([path])[0].metadata["full_scale"]) == pytest.approx(steps)


def test_those_that_stay_far_below_it_are_asked_for(tmp_path: Path) -> None:
    """Of a timer that counts to 10000 a command of 5200 is half of it, and no twelfth."""
    path = in_volts(tmp_path / "a.csv", 5200.0)
    path.write_text(path.read_text().replace("u [V]", "pwm").replace(".0,", ","))
    with pytest.raises(DataError, match="--full-scale"):
        read_any([path])
