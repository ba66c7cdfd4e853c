"""Tables of people's own loggers become logs without a map: what can be known is found, what cannot is asked for."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from table_corpus import CASES, Case, run

from fiohost.bench.log import Log
from fiohost.cli.main import cli
from fiohost.errors import ConfigError, DataError, FiohostError, LogError
from fiohost.importing.automatic import read_any
from fiohost.importing.grid import quantum_of, wrap_of
from fiohost.importing.map import TableMap
from fiohost.importing.read import read_raw
from fiohost.importing.understand import understand
from fiohost.importing.units import name_and_unit, unit_of


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def made(case: Case, folder: Path) -> Path:
    if case.needs:
        pytest.importorskip(case.needs, reason=f"{case.needs} IS NOT INSTALLED: {case.name} is not tested")
    path = folder / f"{case.name.replace(' ', '_')}{case.values.get('suffix', '.csv')}"
    case.make(path)
    return path


@pytest.mark.long
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_table_is_imported_in_one_command_or_refused_in_one_sentence_that_says_what_is_unknown(
    case: Case, tmp_path: Path
) -> None:
    table, out = made(case, tmp_path), tmp_path / "log.csv"
    if case.unknown:
        refused = call("import", table, "--yes", "-o", out)
        assert refused.exit_code == 1, refused.output
        assert case.unknown in refused.stderr
        assert len(refused.stderr.strip().splitlines()) == 1
        assert not out.exists()
        if not case.answers:
            return
    result = call("import", table, "--yes", "-o", out, *case.answers)
    assert result.exit_code == 0, result.stderr
    log, truth = Log.read(out), run()
    assert log.output_name == case.column
    assert len(log) == case.rows
    assert log.sample_time_s == pytest.approx(case.step_s, rel=1e-4)
    rows = log.tick  # of the rows that are there
    want = (truth.angle if case.column == "angle_deg" else truth.speed)[rows] * case.values.get("factor", 1.0)
    off = log.output - want
    if case.column == "angle_deg":
        off = off - (off[0] if case.values.get("zeroed") else 360.0 * np.rint(off[0] / 360.0))
    assert np.abs(off).max() < case.tolerance
    assert np.abs(log.duty_pct * case.full_range / 100.0 - truth.duty[rows]).max() < case.duty_tolerance
    if case.quantum is not None:
        assert log.output_quantum == pytest.approx(case.quantum, rel=1e-3)
    if case.beside:
        assert case.beside in log.columns
    assert (tmp_path / "log.png").stat().st_size > 10_000
    again = tmp_path / "again.csv"
    mapped = call("import", table, "--map", tmp_path / "log.map.toml", "-o", again)
    assert mapped.exit_code == 0, mapped.stderr
    for name, values in Log.read(again).columns.items():
        np.testing.assert_array_equal(values, log.columns[name], err_msg=f"the map that was written reads {name} anew")


def test_there_are_tables_enough() -> None:
    assert len(CASES) >= 25


REAL = {
    "nxt_open_loop": "",
    "emps": "",
    "bldc_torque": "",
    "brake_pwm_gearmotor": "unknown is",
    "coast_pwm_gearmotor": "unknown is",
    "direct_drive_foc": "unknown is the unit of the output 'Position'",
}


@pytest.mark.parametrize("bench", REAL)
def test_every_real_file_is_understood_or_refused_in_one_sentence(bench: str, measured_data: Path) -> None:
    tables = sorted((measured_data / "measured" / bench).glob("*.csv"))
    assert tables
    for table in tables:
        found = understand(read_raw(table))
        if REAL[bench]:
            with pytest.raises(DataError, match=REAL[bench]) as caught:
                _ = found.certain
            assert "\n" not in str(caught.value)
        else:
            assert found.certain.time_column is not None


def test_what_is_said_completes_what_is_found_on_real_data(measured_data: Path, tmp_path: Path) -> None:
    table = measured_data / "measured" / "brake_pwm_gearmotor" / "prbs_open_exp_2026-08-11.csv"
    out = tmp_path / "log.csv"
    result = call("import", table, "--yes", "--unit", "deg/s", "--full-scale", "5", "-o", out, "--json", "-")
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    shipped = TableMap.load("brake_pwm_gearmotor")
    assert found["output_quantum"] == pytest.approx(shipped.quantum, rel=1e-4)
    assert found["output_average"] == shipped.average
    assert found["duty_pct"] == pytest.approx([36.65, 61.68], abs=0.01)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"", "empty"),
        (b"hello\nworld\n", "no row of numbers"),
        (b"t [s];u [V];angle [deg]\n0;1;2\n0,1;1\n0,2;1;2\n", "line 3: 2 cells under 3"),
        (b"t [s],u [%],angle [deg]\n0,1,2\n0.1,1,3\n0.05,1,3\n0.2,1,3\n", "runs backwards"),
        (b"t [s],u [%],angle [deg]\n1,1,2\n1,1,3\n1,1,3\n", "stands still"),
        (b"t,u,y\n0,0,1,5,2,0\n0,1,1,5,2,1\n0,2,1,5,2,2\n", "cannot be told apart"),
        (b"PK\x03\x04whatever", "Excel workbook"),
        (b"\x1f\x8bwhatever", "compressed"),
        (b"t [s],u [%],angle [deg]\n0,150,2\n0.1,1,3\n0.2,1,3\n", "150 % of full scale"),
        (b"\x89HDF\r\n\x1a\nnot really", "cannot be read as HDF5"),
        (b"MATLAB 5.0 MAT-file".ljust(200, b"\xff"), "cannot be read as a MATLAB file"),
        (b"PAR1 and nothing", "cannot be read as Parquet"),
        (b"time_s,duty_pct,angle_deg\n0,5,1\n" * 3, "stands still"),
    ],
)
def test_what_is_no_table_is_refused_in_one_sentence_and_nothing_is_written(
    text: bytes, says: str, tmp_path: Path
) -> None:
    for magic, library in ((b"\x89HDF", "h5py"), (b"PAR1", "pyarrow")):
        if text.startswith(magic):
            pytest.importorskip(library)
    table = tmp_path / "table.csv"
    table.write_bytes(text)
    result = call("import", table, "--yes", "-o", tmp_path / "log.csv")
    assert result.exit_code == 1
    assert says in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]


def test_random_bytes_and_broken_tables_never_end_in_anything_but_a_sentence(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    whole = b"Zeit [s];Spannung [V];Winkel [Grad]\r\n" + b"".join(
        b"%d,%02d;1,5;%d\r\n" % (i // 50, 2 * i % 100, i) for i in range(60)
    )
    path = tmp_path / "t.csv"
    for _ in range(120):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), int(rng.integers(1, 30))):
            data[at] = rng.integers(0, 256)
        path.write_bytes(bytes(data[: rng.integers(1, len(data))]))
        said = ""
        try:
            found = understand(read_raw(path))
            read_any([path], found.answers)
        except FiohostError as exc:
            said = str(exc)
        assert "\n" not in said


def test_a_library_that_is_absent_is_named_with_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    path = tmp_path / "run.h5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(ConfigError, match=r"needs h5py: pip install 'fiohost\[data\]'"):
        read_raw(path)


def test_assumptions_are_not_taken_in_silence_where_nobody_can_be_asked(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    table.write_text("t [s],u [V],angle [deg]\n" + "".join(f"{i / 100},{3 + i % 2},{i}\n" for i in range(50)))
    result = call("import", table, "-o", tmp_path / "log.csv")
    assert result.exit_code == 1
    assert "say --yes" in result.stderr
    assert "full scale" in result.stdout


def test_a_log_is_not_imported_again(tmp_path: Path) -> None:
    log = tmp_path / "run.csv"
    log.write_text("# schema: fiohost.log/1\ntime_s,duty_pct,angle_deg\n0,1,0\n0.1,1,0\n")
    result = call("import", log, "--yes")
    assert result.exit_code == 1
    assert "is a log of fiohost already" in result.stderr


def test_several_tables_of_one_bench_share_one_full_scale(tmp_path: Path) -> None:
    for name, level in (("a", 4), ("b", 11)):
        rows = "".join(f"{i / 100},{level},{i * level}\n" for i in range(50))
        (tmp_path / f"{name}.csv").write_text("t [s],u [V],angle [deg]\n" + rows)
    logs = read_any([tmp_path / "a.csv", tmp_path / "b.csv"])
    assert [round(float(log.duty_pct[0]), 2) for log in logs] == [33.33, 91.67]
    assert "12 V" in logs[0].metadata["understood"]


@pytest.mark.parametrize("stamp", ["22.11.2026 09:30:{:06.3f}", "2026-11-22T09:30:{:06.3f}", "09:30:{:06.3f}"])
def test_a_log_of_dates_begins_at_zero_and_keeps_the_date(stamp: str, tmp_path: Path) -> None:
    table = tmp_path / "dated.csv"
    rows = "".join(f"{stamp.format(i / 100)};{3 + i % 7};{i * 0.7:.1f}\n" for i in range(100))
    table.write_text("Zeit;duty [%];speed [rpm]\n" + rows)
    done = call("import", table, "--yes", "-o", tmp_path / "log.csv")
    assert done.exit_code == 0, done.stderr
    log = Log.read(tmp_path / "log.csv")
    assert log.time_s[0] == 0.0
    assert log.time_s[-1] == pytest.approx(0.99)
    assert log.metadata.get("start_time", "") == ("2026-11-22T09:30:00" if "2026" in stamp else "")
    assert ",25.2\n" in (tmp_path / "log.csv").read_text()  # 4.2 rpm: no 25.200000000000003


def test_a_table_without_names_is_told_by_two_words(tmp_path: Path) -> None:
    table = tmp_path / "bare.txt"
    table.write_text("".join(f"{i / 100:.2f} {30 + i % 7} {i * 0.73:.2f}\n" for i in range(100)))
    told = ("--command", "column 2", "--measured", "column 3", "--unit", "deg", "--full-scale", "100")
    done = call("import", table, "--yes", *told, "-o", tmp_path / "log.csv")
    assert done.exit_code == 0, done.stderr
    assert "assumed: 'column 1', which rises in even steps, is the time" in done.stdout
    table.write_text("".join(f"{i} {30 + i % 7} {i * 0.73:.2f}\n" for i in range(100)))  # numbers of rows are no times
    assert "--sample-time" in call("import", table, "--yes", *told).stderr


def test_a_column_named_voltage_is_in_volts_and_that_is_said(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    table.write_text("t [s],voltage,angle [deg]\n" + "".join(f"{i / 100},{3.1 + i % 8},{i}\n" for i in range(50)))
    done = call("import", table, "--yes", "-o", tmp_path / "log.csv")
    assert "assumed: 'voltage' is in V; full scale of 'voltage' is 12 V" in done.stdout


def test_a_table_of_readings_is_no_log_whose_time_runs_backwards(tmp_path: Path) -> None:
    table = tmp_path / "readings.csv"
    table.write_text("kp,overshoot_pct,settling_s,rise_s\n0.5,0,1.2,0.9\n1,3,0.7,0.5\n2,21,0.9,0.3\n")
    refused = call("import", table, "--yes")
    assert refused.exit_code == 1
    assert "diagnose --readings" in refused.stderr


def test_frames_are_logs_too() -> None:
    pandas = pytest.importorskip("pandas")
    r = run()
    frame = pandas.DataFrame(
        {"duty_pct": r.duty, "speed_rpm": r.speed / 6.0}, index=pandas.Index(r.time_s, name="time_s")
    )
    (log,) = read_any([frame])
    np.testing.assert_allclose(log.output, r.speed, atol=1e-8)
    np.testing.assert_allclose(log.time_s, r.time_s)


def test_diagnose_and_identify_and_plot_take_a_plain_table_folders_and_patterns(tmp_path: Path) -> None:
    case = next(c for c in CASES if c.name == "german dates")
    other = next(c for c in CASES if c.name == "plain")
    folder = tmp_path / "runs"
    folder.mkdir()
    other.make(folder / "one.csv")
    case.make(tmp_path / "drehzahl.csv")
    found = call("identify", folder, "--from", "duty", "--json", "-")
    assert found.exit_code == 0, found.stderr
    assert json.loads(found.stdout)["parameters"]["tau_s"]["value"] == pytest.approx(0.08, rel=0.05)
    drawn = call("plot", tmp_path / "dreh*.csv", folder, "-o", tmp_path / "p.svg")
    assert drawn.exit_code == 0, drawn.stderr
    assert (tmp_path / "p.svg").stat().st_size > 10_000
    assert "no file fits" in call("diagnose", folder, "--holdout", tmp_path / "no*.csv").stderr


@pytest.mark.parametrize(
    ("head", "name", "base"),
    [
        ("Speed [rpm]", "Speed", "rpm"), ("n / min^-1", "n", "rpm"), ("Drehzahl (1/min)", "Drehzahl", "rpm"),
        ("omega_rad_s", "omega", "rad/s"), ("Winkel in Grad", "Winkel", "deg"), ("t, s", "t", "s"),
        ("time_ms", "time", "s"), ("u(V)", "u", "V"), ("Strom/mA", "Strom", "A"), ("pos_counts", "pos", "counts"),
        ("angle", "angle", ""), ("current", "current", ""),
    ],
)  # fmt: skip
def test_names_and_units_in_heads(head: str, name: str, base: str) -> None:
    found = name_and_unit(head)
    unit = unit_of(found[1])
    assert (found[0], unit.base if unit else "") == (name, base)


def test_the_grid_of_a_sensor_and_its_turn() -> None:
    rng = np.random.default_rng(1)
    assert quantum_of(np.round(rng.normal(0, 300, 5000) / 6.43) * 6.43) == pytest.approx(6.43, rel=1e-6)
    assert quantum_of(rng.normal(0, 300, 5000)) == 0.0
    turning = np.cumsum(rng.normal(5, 1, 2000))
    assert wrap_of(turning % 360.0, "deg") == 360.0
    assert wrap_of(np.floor(turning % 720), "counts") == 720.0
    assert wrap_of(turning, "deg") == 0.0


def test_new_keys_of_a_map_are_read_and_checked(tmp_path: Path) -> None:
    def load(**output: Any) -> TableMap:
        lines = [
            'schema = "fiohost.map/1"',
            "[time]",
            'column = "t"',
            "[command]",
            'column = "u"',
            "full_scale_V = 12",
            "[output]",
        ]
        told = {"column": "y", "quantity": "speed", "unit": "rpm", **output}
        lines += [f"{k} = {json.dumps(v)}" for k, v in told.items()]
        lines += ["[[beside]]", 'column = "i"', 'name = "current_A"']
        path = tmp_path / "m.toml"
        path.write_text("\n".join(lines) + os.linesep)
        return TableMap.load(path)

    table = tmp_path / "t.csv"
    table.write_text("t,u,y,i\n0,6,10,1\n0.1,-6,20,2\n0.2,-6,5,3\n0.3,-6,30,4\n")
    from fiohost.importing.convert import log_from_table

    log = log_from_table(table, load(signed=False, scale=2.0, offset=1.0, noise_rms=0.5))
    np.testing.assert_allclose(log.duty_pct, [50, -50, -50, -50])
    np.testing.assert_allclose(np.abs(log.output), 6.0 * (2.0 * np.array([10, 20, 5, 30]) + 1.0))
    assert log.output[0] > 0 > log.output[-1]
    assert log.output_noise_rms == pytest.approx(3.0)
    np.testing.assert_allclose(log.columns["current_A"], [1, 2, 3, 4])
    with pytest.raises(ConfigError, match="for a speed without sign"):
        load(quantity="angle", unit="deg", signed=False)
    with pytest.raises(ConfigError, match="counts_per_rev is for counts"):
        load(counts_per_rev=100)
    with pytest.raises(LogError, match="no column 'y'"):
        log_from_table(
            tmp_path / "u.csv" if (tmp_path / "u.csv").write_text("t,u,i\n0,1,2\n1,2,3\n") else table, load()
        )


@pytest.mark.parametrize("remark", ["L\u00fcfter an", ""])
def test_a_column_of_remarks_that_one_line_fills_is_no_delimiter_at_the_end(remark: str, tmp_path: Path) -> None:
    """Without it the row with the remark, and with that the names above it, went lost."""
    rows = [f"22.11.2026 09:30:{k // 100:02d},{10 * (k % 100):03d};{k % 7},5;{3 * (k % 7)},0;" for k in range(500)]
    rows[0] += remark
    lines = ["Pr\u00fcfstand 3;;;", "Zeitstempel;Spannung [V];Drehzahl [1/min];Bemerkung", *rows]
    table = tmp_path / "Messung.csv"
    table.write_bytes(("\r\n".join(lines) + "\r\n").encode("cp1252"))
    raw = read_raw(table)
    assert [column.name for column in raw.columns] == [
        "Zeitstempel", "Spannung [V]", "Drehzahl [1/min]", "Bemerkung"
    ]  # fmt: skip
    assert len(raw.columns[0].values) == 500
    told = call("import", table, "--yes", "-o", tmp_path / "log.csv")
    assert told.exit_code == 0, told.stderr
    assert len(Log.read(tmp_path / "log.csv")) == 500


@pytest.mark.parametrize(("rows", "ahead"), [(1, 0), (2, 1), (4, 0), (5, 0)])
def test_a_speed_over_several_rows_is_taken_apart(rows: int, ahead: int, tmp_path: Path) -> None:
    """As ``gradient`` gives it, or a moving average: taken for a mean since the row before it would come too early, or
    too late.
    """
    times, rng = np.arange(0.0, 8.0, 0.005), np.random.default_rng(1)
    duty = np.repeat(rng.uniform(-80.0, 80.0, 16), 100)
    speed_rpm = np.convolve(40.0 * duty, np.exp(-times / 0.08) * 0.005 / 0.08)[: len(times)]
    since = np.diff(np.floor(np.cumsum(speed_rpm) / 60.0 * 0.005 * 4096), prepend=0.0) * 60.0 / 4096 / 0.005
    over = np.convolve(since, np.ones(rows) / rows)[ahead : ahead + len(times)]
    lines = "\n".join(f"{t:.3f},{u:.2f},{v:.2f}" for t, u, v in zip(times, duty, over, strict=True))
    table = tmp_path / "run.csv"
    table.write_text(f"time_s,pwm_percent,speed_rpm\n{lines}\n")
    found = understand(read_raw(table)).certain
    assert found.over_rows == (rows, ahead)
    written = tmp_path / "map.toml"
    written.write_text(found.to_toml())
    assert TableMap.load(written).over_rows == (rows, ahead)
    (log,) = read_any([table])
    assert (log.output_average, log.output_quantum) == ("previous_interval", pytest.approx(6 * 60.0 / 4096 / 0.005))
    assert np.allclose(log.output[rows:], 6.0 * since[rows:], atol=0.1)
