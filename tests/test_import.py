"""Foreign tables become logs, with units, times and sensor stated; what cannot be read is refused in a sentence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from fiohost.bench.log import Log
from fiohost.cli.main import cli
from fiohost.errors import ConfigError, DataError, FiohostError, LogError
from fiohost.importing.convert import import_table, log_from_table
from fiohost.importing.map import TableMap
from fiohost.settings import Table, config_names

MAP: dict[str, Any] = {
    "schema": "fiohost.map/1",
    "time": {"column": "t"},
    "command": {"column": "u", "scale": 20.0},
    "output": {"column": "y", "quantity": "speed", "unit": "deg/s", "average": "previous_interval", "quantum": 6.43},
}


def make_map(**sections: Any) -> TableMap:
    return TableMap.from_table(Table({**MAP, **sections}, "test map"), "test")


def write(folder: Path, text: str, name: str = "table.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode())
    return path


GOOD = "t,u,y\n0.00,1.0,10\n0.02,2.0,20\n0.04,-5.0,30\n"


def test_a_table_becomes_a_log_that_says_where_it_came_from(tmp_path: Path) -> None:
    out = tmp_path / "log.csv"
    log = import_table(write(tmp_path, GOOD), make_map(), out)
    again = Log.read(out)
    for one in (log, again):
        assert one.output_name == "speed_deg_s"
        np.testing.assert_allclose(one.time_s, [0.0, 0.02, 0.04])
        np.testing.assert_allclose(one.duty_pct, [20.0, 40.0, -100.0])
        np.testing.assert_allclose(one.output, [10.0, 20.0, 30.0])
        assert one.sample_time_s == pytest.approx(0.02)
        assert one.output_average == "previous_interval"
        assert one.output_quantum == pytest.approx(6.43)
        assert one.command_delay_ticks == 0
        assert one.metadata["source"] == "table.csv"
        assert float(one.metadata["full_scale"]) == pytest.approx(5.0)
    assert again.dropped == ()


def test_the_same_table_in_memory_is_the_same_data_under_the_tables_own_hash(tmp_path: Path) -> None:
    table = write(tmp_path, GOOD)
    memory, written = log_from_table(table, make_map()), import_table(table, make_map(), tmp_path / "log.csv")
    assert memory.path == table
    assert memory.sha256 == written.metadata["source_sha256"]
    for name, values in written.columns.items():
        np.testing.assert_array_equal(memory.columns[name], values)


@pytest.mark.parametrize(
    ("quantity", "unit", "column", "factor"),
    [
        ("angle", "deg", "angle_deg", 1.0),
        ("angle", "rad", "angle_deg", 180 / np.pi),
        ("speed", "deg/s", "speed_deg_s", 1.0),
        ("speed", "rad/s", "speed_deg_s", 180 / np.pi),
        ("speed", "m/s", "speed_m_s", 1.0),
        ("position", "m", "position_m", 1.0),
        ("position", "mm", "position_m", 1e-3),
    ],
)
def test_units_are_converted_and_the_quantum_with_them(
    tmp_path: Path, quantity: str, unit: str, column: str, factor: float
) -> None:
    table_map = make_map(output={"column": "y", "quantity": quantity, "unit": unit, "quantum": 0.5})
    log = log_from_table(write(tmp_path, GOOD), table_map)
    assert log.output_name == column
    np.testing.assert_allclose(log.output, np.array([10.0, 20.0, 30.0]) * factor)
    assert log.output_quantum == pytest.approx(0.5 * factor)


def test_counts_that_wrap_become_a_continuous_angle_with_one_count_as_the_quantum(tmp_path: Path) -> None:
    counts = {"column": "y", "quantity": "angle", "unit": "counts", "wrap": 720}
    text = "t,u,y\n0.00,1,700\n0.02,1,710\n0.04,1,0\n0.06,1,10\n0.08,1,715\n"
    log = log_from_table(write(tmp_path, text), make_map(output=counts))
    np.testing.assert_allclose(log.output, [350.0, 355.0, 360.0, 365.0, 357.5])
    assert log.output_quantum == pytest.approx(0.5)
    assert log.counts_per_rev == 720


def test_an_angle_that_ranges_over_many_turns_is_not_unwrapped_again(tmp_path: Path) -> None:
    output = {"column": "y", "quantity": "angle", "unit": "deg", "wrap": 360}
    text = "t,u,y\n" + "".join(f"{0.02 * i:.2f},1,{300 * i}\n" for i in range(5))
    log = log_from_table(write(tmp_path, text), make_map(output=output))
    np.testing.assert_allclose(np.diff(log.output), 300.0)


def test_tables_without_time_or_command_columns_take_them_from_the_map(tmp_path: Path) -> None:
    table_map = make_map(time={"sample_time_s": 0.01}, command={"constant": 50, "delay_ticks": 2})
    log = log_from_table(write(tmp_path, "y\n1\n2\n3\n"), table_map)
    np.testing.assert_allclose(log.time_s, [0.0, 0.01, 0.02])
    np.testing.assert_allclose(log.duty_pct, 50.0)
    assert log.command_delay_ticks == 2


@pytest.mark.parametrize(
    "text",
    [
        "# made by hand\n\nt;u;y\n0,00;1,0;10\n0,02;2,0;20\n0,04;-5,0;30\n",
        "t\tu\ty\n0.00\t1.0\t10\n0.02\t2.0\t20\n0.04\t-5.0\t30\n",
        "t  u   y\n0.00 1.0 10\n0.02 2.0 20\n0.04 -5.0 30\n",
        "\ufeffn,t,u,y,note\r\n1,0.00,1.0,10,start\r\n2,0.02,2.0,20,\r\n3,0.04,-5.0,30,\r\n",
        't, u, "y"\n0.00, 1.0, "10"\n0.02, 2.0, 20\n0.04, -5.0, 30',
    ],
    ids=["semicolons and decimal commas", "tabs", "spaces", "windows with extra columns", "quotes, no last newline"],
)
def test_delimiters_comments_and_extra_columns_do_not_matter(tmp_path: Path, text: str) -> None:
    log = log_from_table(write(tmp_path, text), make_map())
    np.testing.assert_allclose(log.duty_pct, [20.0, 40.0, -100.0])
    np.testing.assert_allclose(log.output, [10.0, 20.0, 30.0])


def test_the_sample_time_survives_times_printed_with_few_digits_and_missing_rows(tmp_path: Path) -> None:
    ticks = [i for i in range(300) if i not in (50, 51)]
    text = "t,u,y\n" + "".join(f"{i / 30:.2f},1,{i}\n" for i in ticks)
    log = log_from_table(write(tmp_path, text), make_map())
    assert log.sample_time_s == pytest.approx(1 / 30, rel=2e-3)
    assert len(log) == 298
    assert any("2 ticks are missing" in note for note in log.dropped)


def test_an_incomplete_last_line_is_dropped_and_said_so(tmp_path: Path) -> None:
    log = import_table(write(tmp_path, GOOD + "0.06,1."), make_map(), tmp_path / "log.csv")
    assert len(log) == 3
    assert any("incomplete" in note for note in log.dropped)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "is empty"),
        ("# nothing but a comment\n", "is empty"),
        ("t,u,y\n", "no row of numbers"),
        ("t,u,speed\n0,1,2\n", "no column 'y'"),
        ("time,u,y\n0,1,2\n", "no column 't'"),
        ("0,1,2\n0.02,1,2\n", "header row"),
        ("t,u,y,y\n0,1,2,3\n", "2 columns named 'y'"),
        ("t,u,y\n0,1,2\n0.02,fast,3\n0.04,1,4\n", "line 3, column 'u': 'fast' is not a number"),
        ("t,u,y\n0,1,2\n0.02,1,nan\n0.04,1,4\n", "'nan' is not a finite number"),
        ("t,u,y\n0,1,2\n0.02,1,1e308\n0.04,1,4\n", "'1e308' is not a finite number below 1e+30"),
        ("t,u,y\n0,1,2\n0.02,1,\n0.04,1,4\n", "an empty cell is not a number"),
        ("t,u,y\n0,1,2\n0.02,1\n0.04,1,4\n", "line 3: 2 cells under 3 column names"),
        ("t,u,y\n0,1,2\n0.02,1,3,4,5\n0.04,1,4\n", "line 3: 5 cells under 3 column names"),
        ("t,u,y\n0,1,2\n0.02,1,3\n0.01,1,4\n", "time does not increase"),
        ("t,u,y\n0,1,2\n", "one row"),
        ("t,u,y\n0,1,2\n0.02,7,3\n", "140 % of full scale"),
        ("t,u,y\n" + "1" * 200_000 + "\n", "longer than"),
        ("t\0u\0y\n", "not a text table"),
    ],
)
def test_what_is_not_a_table_is_refused_in_one_sentence_and_leaves_nothing(
    tmp_path: Path, text: str, says: str
) -> None:
    table, out = write(tmp_path, text), tmp_path / "log.csv"
    with pytest.raises(FiohostError) as caught:
        import_table(table, make_map(), out)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["table.csv"]


def test_missing_files_folders_and_unwritable_outputs_are_refused(tmp_path: Path) -> None:
    table = write(tmp_path, GOOD)
    with pytest.raises(LogError, match="cannot read"):
        log_from_table(tmp_path / "absent.csv", make_map())
    with pytest.raises(LogError, match="it is a directory, not a file"):
        log_from_table(tmp_path, make_map())
    with pytest.raises(FiohostError, match="cannot write"):
        import_table(table, make_map(), tmp_path / "no such folder" / "log.csv")
    with pytest.raises(FiohostError, match="it exists"):
        import_table(table, make_map(), table)
    assert table.read_text() == GOOD


@pytest.mark.parametrize(
    ("sections", "says"),
    [
        ({"output": {"column": "y", "quantity": "speed", "unit": "deg/sec"}}, "did you mean 'deg/s'"),
        ({"output": {"column": "y", "quantity": "speed", "unit": "deg"}}, "not a unit of speed"),
        ({"output": {"column": "y", "quantity": "angle", "unit": "counts"}}, "needs wrap"),
        ({"output": {"column": "y", "quantity": "speed", "unit": "deg/s", "quantumm": 1}}, "did you mean 'quantum'"),
        (
            {"output": {"column": "y", "quantity": "speed", "unit": "rpm", "average": "neighbours"}},
            "say its quantum",
        ),
        (
            {"output": {"column": "y", "quantity": "speed", "unit": "rpm", "average_rows": 4, "quantum": 1.0}},
            "average_rows is for",
        ),
        (
            {"output": {"column": "y", "quantity": "angle", "unit": "deg", "average": "previous_interval"}},
            "for a speed",
        ),
        ({"output": {"quantity": "angle", "unit": "deg"}}, "'column' is missing"),
        ({"command": {"column": "u", "constant": 3}}, "exactly one of 'column' and 'constant'"),
        ({"command": {"column": "u", "scale": 0}}, "scale must not be 0"),
        ({"command": {"column": "u", "scale": float("nan")}}, "not a finite number"),
        ({"command": {"column": "u", "delay_ticks": 0.5}}, "not a whole number"),
        ({"time": {}}, "exactly one of 'column' and 'sample_time_s'"),
        ({"schema": "fiohost.map/2"}, "expected 'fiohost.map/1'"),
        ({"outputs": {}}, "did you mean 'output'"),
    ],
)
def test_a_map_with_unknown_or_contradicting_keys_is_refused(sections: dict[str, Any], says: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make_map(**sections)
    assert says in str(caught.value)


def test_every_shipped_map_is_read() -> None:
    names = config_names("maps")
    assert {"nxt_open_loop", "brake_pwm_gearmotor", "emps"} <= set(names)
    for name in names:
        assert TableMap.load(name).name == name
    with pytest.raises(ConfigError, match="did you mean 'emps'"):
        TableMap.load("emp")


@pytest.mark.parametrize(
    ("file", "name", "rows", "unit", "duty"),
    [
        ("nxt_open_loop/power_040.csv", "nxt_open_loop", 7498, "deg", (40.0, 40.0)),
        ("brake_pwm_gearmotor/prbs_open_exp_2026-08-11.csv", "brake_pwm_gearmotor", 4093, "deg/s", (36.65, 61.68)),
        ("emps/train.csv", "emps", 24841, "m", (-43.26, 41.38)),
    ],
)
def test_shipped_maps_fit_the_real_tables_they_were_made_for(
    measured_data: Path, file: str, name: str, rows: int, unit: str, duty: tuple[float, float]
) -> None:
    log = log_from_table(measured_data / "measured" / file, TableMap.load(name))
    assert len(log) == rows
    assert log.output_unit == unit
    assert log.dropped == ()
    assert (log.duty_pct.min(), log.duty_pct.max()) == pytest.approx(duty, abs=0.01)


def test_a_table_whose_command_exceeds_full_scale_by_rounding_is_clipped(tmp_path: Path) -> None:
    log = log_from_table(write(tmp_path, "t,u,y\n0,5.0000002,1\n0.02,-5.0000002,2\n"), make_map())
    np.testing.assert_array_equal(log.duty_pct, [100.0, -100.0])
    with pytest.raises(DataError):
        log_from_table(write(tmp_path, "t,u,y\n0,5.1,1\n0.02,-5,2\n"), make_map())


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def test_the_command_writes_the_log_and_says_what_it_holds(tmp_path: Path) -> None:
    table = write(tmp_path, "time_s,power_pct,angle_deg\n0,40,0\n0.004,40,1\n0.008,40,3\n0.0")
    out = tmp_path / "log.csv"
    result = call("import", table, "--map", "nxt_open_loop", "-o", out, "--json", "-")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert (found["rows"], found["sample_time_s"], found["output_unit"]) == (3, 0.004, "deg")
    assert "3 rows" in result.stderr
    assert "incomplete" in result.stderr
    np.testing.assert_allclose(Log.read(out).output, [0.0, 1.0, 3.0])


@pytest.mark.parametrize(
    ("table", "map_name", "out", "says"),
    [
        ("absent.csv", "emps", "log.csv", "cannot read"),
        ("table.csv", "emp", "log.csv", "did you mean 'emps'"),
        ("table.csv", "emps", "log.csv", "no column 'time_s'"),
        ("table.csv", "emps", "absent/log.csv", "cannot write"),
    ],
)
def test_the_command_refuses_with_one_sentence_and_exit_1(
    tmp_path: Path, table: str, map_name: str, out: str, says: str
) -> None:
    write(tmp_path, GOOD)
    result = call("import", tmp_path / table, "--map", map_name, "-o", tmp_path / out)
    assert result.exit_code == 1
    assert says in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not (tmp_path / out).exists()


def test_the_library_of_effects_is_listed_with_parameters_and_explained_by_name() -> None:
    listed = call("effects", "--json", "-")
    names = [item["name"] for item in json.loads(listed.stdout)["effects"]]
    assert {"linear", "coulomb_friction", "gravity_load", "backlash"} <= set(names)
    one = call("effects", "gravity_load")
    assert "level_pct" in one.stdout
    assert "cogging_torque" in one.stdout
    wrong = call("effects", "gravity")
    assert wrong.exit_code == 1
    assert "did you mean 'gravity_load'" in wrong.stderr
