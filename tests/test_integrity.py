"""A log that was cut off or altered is known by its last line, and it is said what is missing."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from fiohost.bench.integrity import ALTERED, CUT_OFF, UNKNOWN, WHOLE, judge
from fiohost.bench.log import Log
from fiohost.cli.main import cli


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    command = ["manual", "--pwm", "40", "--duration", "0.5", "--fast", "--log", "run.csv"]
    assert CliRunner().invoke(cli, command).exit_code == 0
    return tmp_path / "run.csv"


def check(*logs: Path) -> Result:
    return CliRunner().invoke(cli, ["check", *(str(log) for log in logs)])


def test_a_whole_log_is_whole_and_reads_as_before(log: Path) -> None:
    done = check(log)
    assert done.exit_code == 0, done.output
    assert "whole, 100 of 100 rows, the last at 0.495 s; ending: complete" in done.stdout
    read = Log.read(log)
    assert (len(read), read.dropped) == (100, ())
    assert log.read_text().splitlines()[-1].startswith("# end: rows=100 crc32_head=")


def test_every_byte_counts(log: Path) -> None:
    data = log.read_bytes()
    for at in [*range(0, len(data), 7), len(data) - 2]:
        changed = data[:at] + bytes([data[at] ^ 0x01]) + data[at + 1 :]
        assert judge(changed).state != WHOLE, (at, changed[max(0, at - 20) : at + 20])
    assert judge(data).state == WHOLE


def test_a_log_cut_at_any_place_is_not_whole(log: Path) -> None:
    data = log.read_bytes()
    for at in range(len(data) - 2, 0, -11):
        found = judge(data[:at])
        assert found.state != WHOLE
        assert found.rows <= 100


def test_a_cut_in_mid_line_is_told_from_one_between_lines(log: Path) -> None:
    data = log.read_bytes()
    between = data.rindex(b"\n", 0, len(data) - 1) + 1
    in_the_middle = "the last line is cut off in its middle"
    assert in_the_middle not in judge(data[:between]).notes
    assert in_the_middle in judge(data[: between - 3]).notes
    assert in_the_middle in judge(data[:50]).notes  # of the head
    assert in_the_middle not in judge(b"").notes


def test_what_is_missing_is_said(log: Path) -> None:
    lines = log.read_text().splitlines(keepends=True)
    first = next(i for i, line in enumerate(lines) if line[0].isdigit())
    gone = log.with_name("gone.csv")
    gone.write_text("".join(lines[: first + 10] + lines[first + 13 :]))
    done = check(gone)
    assert done.exit_code == 1
    assert "ALTERED, 97 of 100 rows" in done.stdout
    assert "3 rows are missing" in done.stdout
    assert "3 ticks are missing" in done.stdout
    assert any("altered since it was written" in note for note in Log.read(gone).dropped)
    cut = log.with_name("cut.csv")
    cut.write_text("".join(lines[: first + 40]) + "0.2,40")
    done = check(cut, log)
    assert done.exit_code == 1
    assert "CUT OFF, 40 rows, the last at 0.195 s" in done.stdout
    assert "the last line is cut off in its middle" in done.stdout
    assert "1 of 2 logs is not whole" in done.stderr
    killed = log.with_name("killed.csv")
    killed.write_text("".join(lines[: first + 40]).replace("# ending: complete", "# ending: unfinished"))
    assert "the host did not close it" in check(killed).stdout
    lost = log.with_name("lost.csv")
    lost.write_text("".join(lines[: first + 40]))
    assert "the end of the file is lost" in check(lost).stdout


def test_what_stands_behind_the_last_line_was_added(log: Path) -> None:
    data = log.read_bytes()
    for behind in (b"0.5,40,1,0,3,0,,\n", bytes(4096), b"\n", b"x"):
        found = judge(data + behind)
        assert (found.state, found.rows, found.rows_written) == (ALTERED, 100, 100)
        assert found.notes == (f"{len(behind)} bytes were added behind its last line",)
    twice = judge(data + data)
    assert (twice.state, twice.rows_written) == (ALTERED, 100)
    assert twice.rows > 100


def test_a_head_of_a_thousand_lines_is_none(log: Path) -> None:
    """However many more there are: a file of line ends alone would be looked at one by one."""
    row = b"0,40,1,0,3,0,,\n"
    assert judge(b"\n" * 1000 + b"time_s\n" + row).rows == 1
    assert judge(b"\n" * 1001 + b"time_s\n" + row).rows == 0
    assert judge(b"# a: b\n" * 1001 + b"time_s\n" + row).rows == 0


def test_one_that_cannot_be_read_keeps_no_other_from_being_looked_at(log: Path) -> None:
    gone = log.with_name("gone.csv")
    done = CliRunner().invoke(cli, ["check", str(gone), str(log), "--json", "check.json"])
    assert done.exit_code == 1
    assert f"{gone}: UNREADABLE; cannot read the log" in done.stdout
    assert "whole, 100 of 100 rows" in done.stdout
    assert "1 of 2 logs is not whole" in done.stderr
    found = json.loads(Path("check.json").read_text())["logs"]
    assert [one["state"] for one in found] == ["unreadable", "whole"]


def test_an_edited_number_is_found(log: Path, tmp_path: Path) -> None:
    text = log.read_text()
    for old, new in (("40,1,0,", "41,1,0,"), ("# target: sim", "# target: hid")):
        assert old in text
        edited = tmp_path / "edited.csv"
        edited.write_text(text.replace(old, new, 1))
        assert judge(edited.read_bytes()).state == ALTERED


def test_a_foreign_log_cannot_be_judged_and_an_imported_one_can(tmp_path: Path, log: Path) -> None:
    foreign = tmp_path / "foreign.csv"
    foreign.write_text("time_s,duty_pct,pos\n0,1,2\n0.005,1,3\n")
    assert judge(foreign.read_bytes()).state == UNKNOWN
    Path("map.toml").write_text(
        'schema = "fiohost.map/1"\n[time]\ncolumn = "t"\n[command]\ncolumn = "u"\n[output]\ncolumn = "y"\n'
        'quantity = "angle"\nunit = "deg"\n'
    )
    Path("table.csv").write_text("t,u,y\n0,1,2\n0.01,1,3\n0.02,1,3\n")
    assert CliRunner().invoke(cli, ["import", "table.csv", "--map", "map.toml", "-o", "made.csv"]).exit_code == 0
    assert judge(Path("made.csv").read_bytes()).state == WHOLE
    assert judge(log.read_bytes().rpartition(b"# end")[0]).state == CUT_OFF
    done = CliRunner().invoke(cli, ["check", "made.csv", "--json", "-"])
    assert json.loads(done.stdout)["logs"][0]["rows_written"] == 3
