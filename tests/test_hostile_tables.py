"""Tables made to do harm, or broken in odd ways: bounded work and memory, one sentence, nothing beyond all measure."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from places import PACKAGES

from fiohost.bench.log import Log
from fiohost.cli.main import cli
from fiohost.errors import LogError
from fiohost.importing import binary, raw
from fiohost.importing.cells import column_of, is_comma_number, number, times_of, unit_behind
from fiohost.importing.read import read_raw
from fiohost.importing.units import name_and_unit, unit_of
from fiohost.watch.follow import GrowingLog


def fiohost(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


def table_of(rows: int, **cells: tuple[int, str]) -> str:
    """Time, voltage and angle of a motor; *cells* are put into a row of t, u or y."""
    lines = []
    for k in range(rows):
        row = {"t": f"{0.02 * k:.2f}", "u": "6" if k // 20 % 2 else "3", "y": str(k * (k + 1))}
        row |= {name: text for name, (at, text) in cells.items() if at == k}
        lines.append(",".join(row.values()))
    return "t_s,u_V,angle_deg\n" + "\n".join(lines) + "\n"


@pytest.mark.parametrize("column", ["t", "u", "y"])
@pytest.mark.parametrize("text", ["1e308", "-" + "9" * 60])
def test_one_number_beyond_all_measure_is_a_missing_one(tmp_path: Path, column: str, text: str) -> None:
    """A recorder's mark for no value: it becomes no full scale, no resolution and no picture."""
    at = 99 if column == "t" else 50
    (tmp_path / "t.csv").write_text(table_of(100, **{column: (at, text)}))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = fiohost("import", tmp_path / "t.csv", "--yes", "-o", tmp_path / "log.csv")
    assert result.exit_code == 0, result.output
    log = Log.read(tmp_path / "log.csv")
    assert len(log) == 99
    assert np.abs(log.output).max() < 1e4
    assert np.abs(log.duty_pct).max() == 100.0


def test_rows_of_a_log_beyond_all_measure_are_left_out() -> None:
    head = "time_s,duty_pct,speed_deg_s,ref_deg\n"
    rows = [f"{0.01 * k:.2f},10,{k},0" for k in range(20)]
    log = Log.parse(head + "\n".join([*rows, "0.20,10,1e13,0", "0.21,10,3,-1e200", "1e300,10,3,0"]) + "\n")
    assert len(log) == 21
    assert np.isnan(log.columns["ref_deg"][-1])
    assert any("2 rows with missing or infinite numbers, or beyond 1e+12" in note for note in log.dropped)
    assert any("numbers beyond 1e+12 in column ref_deg" in note for note in log.dropped)
    with pytest.raises(LogError, match="no whole row"):
        Log.parse(head + "0,10,1e300,0\n0.1,10,1e300,0\n")


def test_a_long_cell_or_name_is_no_number_and_has_no_unit() -> None:
    """Each of these took a pattern minutes, or longer than anybody waits."""
    cell = "1," * 5000
    assert number(cell, False) is None
    assert not is_comma_number(cell)
    assert unit_behind("1.111" * 2000 + "x") == ""
    assert unit_of("a" * 50_000 + "per1") is None
    assert name_and_unit(" " * 10 + "u" + " " * 50_000 + "[") == ("u" + " " * 50_000 + "[", "")


@pytest.mark.parametrize("step_s", [1e-300, 1e-8, 4000.0, 1e9])
def test_rows_that_no_recorder_makes_are_refused_and_leave_no_log(tmp_path: Path, step_s: float) -> None:
    rows = "\n".join(f"{k * step_s!r},{k % 2 * 3 + 3},{k * k}" for k in range(60))
    (tmp_path / "t.csv").write_text(f"t_s,u_V,angle_deg\n{rows}\n")
    result = fiohost("import", tmp_path / "t.csv", "--yes", "-o", tmp_path / "log.csv")
    assert result.exit_code == 1
    assert "is the unit of time right?" in result.stderr
    assert os.listdir(tmp_path) == ["t.csv"]


def test_dates_of_the_year_0_are_none() -> None:
    found = times_of(["0000-01-01 00:00:00", "0000-01-01 00:00:01"])
    assert found is not None
    times, began = found
    np.testing.assert_array_equal(times, [0.0, 1.0])
    assert began == ""
    assert column_of("t", "", ["0000-01-01 00:00:00"], False, [1]).kind == raw.TIME


def test_what_unpacks_to_more_than_there_is_room_for_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what the file says of itself, or by unpacking a piece at a time: never by filling the memory first."""
    from scipy.io import savemat

    zeros = np.zeros(300_000)
    savemat(tmp_path / "z.mat", {"s": {"t": zeros, "y": zeros}}, do_compression=True)
    assert (tmp_path / "z.mat").stat().st_size < 10_000
    assert read_raw(tmp_path / "z.mat").rows == 300_000
    monkeypatch.setattr(binary, "MOST_UNPACKED", 4_000_000)
    with pytest.raises(LogError, match="unpacks to more than 4 MB"):
        read_raw(tmp_path / "z.mat")


def test_hdf5_that_unpacks_to_more_is_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason="h5py IS NOT INSTALLED: its files are not tested")
    with h5py.File(tmp_path / "e.h5", "w") as file:
        file["none"], file["t"], file["y"] = h5py.Empty("f8"), [0.0, 1.0], [1.0, 2.0]
    assert read_raw(tmp_path / "e.h5").names == ["t", "y"]
    with h5py.File(tmp_path / "z.h5", "w") as file:
        for name in ("t", "y"):
            file.create_dataset(name, shape=(10**12,), dtype="f8", chunks=(10**6,))
    with pytest.raises(LogError, match="unpacks to more than 1000 MB"):
        read_raw(tmp_path / "z.h5")


def test_parquet_is_refused_by_what_it_says_of_its_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pa = pytest.importorskip("pyarrow", reason="pyarrow IS NOT INSTALLED: its files are not tested")
    from pyarrow import parquet

    parquet.write_table(pa.table({"t": np.zeros(6_000_000), "y": np.zeros(6_000_000)}), tmp_path / "z.parquet")
    read = parquet.ParquetFile.read
    monkeypatch.setattr(parquet.ParquetFile, "read", lambda *_: pytest.fail("it was unpacked"))
    with pytest.raises(LogError, match="more than 5000000 rows"):
        read_raw(tmp_path / "z.parquet")
    monkeypatch.setattr(parquet.ParquetFile, "read", read)
    parquet.write_table(pa.table({"t": [0.0, 1.0], "y": [1e31, 2.0]}), tmp_path / "y.parquet")
    np.testing.assert_array_equal(read_raw(tmp_path / "y.parquet").column("y").values, [np.inf, 2.0])


def test_colours_in_a_name_are_shown_as_what_they_are(tmp_path: Path) -> None:
    table = tmp_path / "\x1b[8mhidden[bold].csv"
    table.write_text(table_of(100))
    result = fiohost("import", table, "--yes", "-o", tmp_path / "log.csv")
    assert result.exit_code == 0, result.output
    assert "\\x1b[8mhidden[bold].csv" in result.output
    assert "\x1b" not in result.output


def test_what_libraries_warn_of_is_for_who_looks_for_a_fault(tmp_path: Path) -> None:
    """A name that no font can draw is no news on standard error; --debug tells it."""
    table = tmp_path / "\U00013000.csv"
    table.write_text(table_of(100))
    command = [sys.executable, "-m", "fiohost", "import", str(table), "--yes", "-o", str(tmp_path / "log.csv")]
    said = subprocess.run(command, capture_output=True, check=False, cwd=PACKAGES)
    assert (said.returncode, said.stderr) == (0, b"")
    said = subprocess.run([*command, "--force", "--debug"], capture_output=True, check=False, cwd=PACKAGES)
    assert b"missing from font" in said.stderr


# ---- files and folders that are none ---------------------------------------------------------------------------------


@pytest.fixture
def odd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a pipe, a loop and a link to a device in it, which is the current one."""
    monkeypatch.chdir(tmp_path)
    os.mkfifo("pipe.csv")
    os.symlink("loop.csv", "loop.csv")
    os.symlink("/dev/zero", "zero.csv")
    return tmp_path


@pytest.mark.parametrize(
    "arguments",
    [
        ["identify", "{}"],
        ["plot", "{}"],
        ["check", "{}"],
        ["import", "{}", "--yes"],
        ["watch", "{}", "--idle", "0"],
        ["fleet", "{}", "--out", "result"],
        ["lab", "grade", "{}"],
        ["export", "{}", "-o", "x.m"],
        ["tf", "--constants", "{}"],
    ],
)
def test_each_entrance_refuses_what_is_no_file_in_one_sentence(odd: Path, arguments: list[str]) -> None:
    for name in ("./pipe.csv", "./loop.csv", "./zero.csv", "n" * 300 + ".csv", "a**b.csv"):
        result = fiohost(*(argument.format(name) for argument in arguments))
        assert result.exit_code == 1, result.output
        assert "error inside" not in result.output
    assert sorted(os.listdir()) == ["loop.csv", "pipe.csv", "zero.csv"]


@pytest.mark.parametrize("arguments", [["identify", "{}"], ["fleet", "{}", "--out", "r"], ["lab", "grade", "{}"]])
def test_a_folder_that_may_not_be_read_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str]
) -> None:
    def forbidden(self: Path) -> Iterator[Path]:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", forbidden)
    result = fiohost(*(argument.format(tmp_path) for argument in arguments))
    assert result.exit_code == 1
    assert f"cannot read the folder {tmp_path}: Permission denied" in result.stderr


def test_a_log_that_is_followed_is_no_output(tmp_path: Path) -> None:
    log = tmp_path / "run.csv"
    log.write_text("time_s,duty_pct,pos\n0,1,2\n")
    result = fiohost("watch", log, "--idle", "0", "--json", log, "--force")
    assert result.exit_code == 1
    assert "this command reads it" in result.stderr
    assert log.read_text() == "time_s,duty_pct,pos\n0,1,2\n"


def test_rows_without_an_end_and_times_that_are_none(tmp_path: Path) -> None:
    log = tmp_path / "run.csv"
    log.write_text("time_s,duty_pct,pos\n0,1,2\nnan,1,2\ninf,1,2\n0.01,1,2\n" + "1" * 10)
    growing = GrowingLog(log)
    assert [time_s for time_s, _ in growing.lines()] == [0.0, 0.01]
    with log.open("a") as file:
        file.write("1" * 2_000_000)
    with pytest.raises(LogError, match="without an end of a line"):
        growing.lines()
    growing.close()


def test_results_of_a_fleet_lie_apart_and_overwrite_nothing(tmp_path: Path) -> None:
    """Neither among the benches, whose next run would take them for one, nor over a page of somebody else's."""
    (tmp_path / "run.csv").write_text("time_s,duty_pct,pos\n0,1,2\n")
    assert "among the benches" in fiohost("fleet", tmp_path, "--out", tmp_path).stderr
    out = tmp_path / "result"
    out.mkdir()
    (out / "fleet.html").write_text("mine")
    assert "it exists" in fiohost("fleet", tmp_path, "--out", out).stderr
    assert (out / "fleet.html").read_text() == "mine"


def test_a_table_of_benches_is_a_file_of_some_size(tmp_path: Path) -> None:
    table = tmp_path / "benches.csv"
    with table.open("wb") as large:
        large.truncate(20_000_000_000)  # sparse
    assert "larger than" in fiohost("fleet", table, "--out", tmp_path / "r").stderr


def test_an_odd_name_that_was_handed_in_stops_nobody_and_is_no_formula(tmp_path: Path) -> None:
    folder, out = tmp_path / "in", tmp_path / "grades.csv"
    folder.mkdir()
    for name in ("=1+1", "anna", "two words"):
        (folder / f"{name}.toml").write_text("schema = 1")
    (folder / "carl.toml").mkdir()
    result = fiohost("lab", "grade", folder, "-o", out)
    assert result.exit_code == 0, result.output
    assert "4 handed in; effects right: 0" in result.output
    rows = list(csv.reader(out.open()))
    assert sorted(row[0] for row in rows[1:]) == ["'=1+1", "anna", "carl", "two words"]
