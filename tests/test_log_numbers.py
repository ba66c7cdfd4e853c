"""A log to the last number: what its reader bounds, counts and says, and what its writer puts where."""

from __future__ import annotations

import errno
import io
import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fiohost.bench import writer as writing
from fiohost.bench.head import needed_columns, read_head
from fiohost.bench.integrity import ALTERED, CUT_OFF, UNKNOWN, WHOLE, end_line, judge
from fiohost.bench.log import Log, LogWriter
from fiohost.bench.rows import parse_rows
from fiohost.bench.table_log import log_text, rows_text
from fiohost.bench.writer import NoLog, one_line
from fiohost.errors import LogError


def log(rows: int = 5, metadata: Mapping[str, str] | None = None, **columns: Any) -> Log:
    plain = {"time_s": [0.25 * k for k in range(rows)], "duty_pct": [10.0] * rows, "pos": list(range(rows))}
    return Log.from_columns(plain | columns, {"sample_time_s": "0.25"} if metadata is None else metadata)


# ---- reading -------------------------------------------------------------------------------------------------------


def test_numbers_beyond_all_sense_are_left_out_and_said() -> None:
    """In a column that is needed with their row, elsewhere by themselves."""
    big = [0.0, 1e12, math.nextafter(1e12, math.inf), -1e12, math.inf]
    made = log(speed_deg_s=big, pos=[0, 1, 2, 3, 4])
    assert len(made) == 5
    np.testing.assert_array_equal(made.columns["speed_deg_s"], [0.0, 1e12, np.nan, -1e12, np.nan])
    assert made.dropped[0] == "numbers beyond 1e+12 in column speed_deg_s"
    columns = {"time_s": [0.25 * k for k in range(5)], "duty_pct": [0.0] * 5, "speed_deg_s": big}
    made = Log.from_columns(columns, {"sample_time_s": "0.25"})
    assert made.output.tolist() == [0.0, 1e12, -1e12]
    assert made.dropped[0] == "2 rows with missing or infinite numbers, or beyond 1e+12 (the first is row 3)"
    assert log(duty_pct=[0.0, math.nan, 0.0, 0.0, 0.0]).dropped[0].startswith("1 rows with missing")


def test_time_that_runs_back_or_stands_is_told_with_its_row() -> None:
    with pytest.raises(LogError, match=r"time runs backwards at row 4 \(0\.5 s, then 0\.25 s\)"):
        log(time_s=[0.0, 0.25, 0.5, 0.25, 0.5])
    made = log(time_s=[0.0, 0.25, 0.25, 0.5, 0.5])
    assert made.dropped[0] == "2 rows that repeat the time of the row before"
    assert (made.time_s.tolist(), made.columns["pos"].tolist()) == ([0.0, 0.25, 0.5], [0.0, 1.0, 3.0])


@pytest.mark.parametrize("wrong", [{"pos": [0, 1]}, {"pos": [[0], [1], [2], [3], [4]]}])
def test_columns_of_a_log_are_of_one_length(wrong: dict[str, Any]) -> None:
    with pytest.raises(LogError, match="arrays of one length"):
        log(**wrong)


def test_a_log_is_known_by_all_that_it_holds() -> None:
    known = log().sha256
    assert log().sha256 == known
    assert log(metadata={"sample_time_s": "0.25", "target": "sim"}).sha256 != known
    assert log(duty_pct=[10.0, 10.0, 10.0, 10.0, 11.0]).sha256 != known
    text = "time_s,duty_pct,pos\n0,1,2\n"
    assert Log.parse(text).sha256 != Log.parse(text + "0.005,1,2\n").sha256
    assert Log.parse(text, sha256="told").sha256 == "told"


def test_a_log_is_shown_in_a_line() -> None:
    assert repr(log()) == "<Log (memory): 5 rows, 1 s of time_s, duty_pct, pos>"
    assert repr(log(1)) == "<Log (memory): 1 rows of time_s, duty_pct, pos>"
    assert repr(log(2)) == "<Log (memory): 2 rows, 0.25 s of time_s, duty_pct, pos>"


def test_stretches_are_spread_from_the_first_row_to_the_last() -> None:
    made = log(100, {"sample_time_s": "0.25", "begins": "at rest"})
    cut = made.stretches(31, 3)
    assert [part.time_s[[0, -1]].tolist() for part in cut] == [[0.0, 2.25], [11.25, 13.5], [22.5, 24.75]]
    assert [part.metadata["begins"] for part in cut] == ["at rest", "moving", "moving"]
    assert cut[0].dropped == ("all but 3 stretches of 10 rows, spread evenly over its 100 rows",)
    assert made.stretches(100, 3) == [made]
    (one,) = made.stretches(50, 1)
    assert one.time_s[[0, -1]].tolist() == [0.0, 12.25]
    made.stretches(99, 2)[0].time_s[0] = 1.0  # a copy
    assert made.time_s[0] == 0.0


def test_the_sample_time_is_the_heads_unless_the_rows_say_otherwise() -> None:
    assert log(metadata={}).sample_time_s == 0.25
    assert log(1, {"sample_time_s": "3600"}).sample_time_s == 3600.0
    with pytest.raises(LogError, match="one row and no sample_time_s"):
        _ = log(1, {}).sample_time_s
    for text in ("3601", "-1", "inf", "nan"):
        with pytest.raises(LogError, match=f"sample_time_s = '{text}', which is no sensible number"):
            log(metadata={"sample_time_s": text})
    assert log(metadata={"sample_time_s": "0.357"}).sample_time_s == 0.357
    with pytest.raises(LogError, match=r"say sample_time_s = 0\.358, but rows are 0\.25 s apart"):
        log(metadata={"sample_time_s": "0.358"})
    assert log(2, {}).sample_time_s == 0.25
    late = log(3, time_s=[1.0, 1.25, 2.0])
    assert late.tick.tolist() == [0, 1, 4]


@pytest.mark.parametrize("key", ["output_quantum", "output_noise_rms", "bench_time_s", "duty_steps", "sample_time_s"])
def test_what_a_head_says_may_be_nothing_and_not_less(key: str) -> None:
    columns = {"time_s": [0.0, 0.25], "duty_pct": [0.0, 0.0], "speed_deg_s": [0.0, 1.0]}
    assert getattr(Log.from_columns(columns, {key: "0"}), key) == (0.25 if key == "sample_time_s" else 0.0)
    assert getattr(Log.from_columns(columns, {key: "0.25" if key[:4] != "duty" else "7"}), key) in (0.25, 7)
    with pytest.raises(LogError, match=key):
        getattr(Log.from_columns(columns, {key: "-1e-300"}), key)


def test_the_largest_duty_steps_and_gaps_of_a_head() -> None:
    assert log(metadata={"duty_steps": "1e10"}).duty_steps == 10**10
    for text in ("10000000001", "1.5"):
        with pytest.raises(LogError, match="duty_steps"):
            _ = log(metadata={"duty_steps": text}).duty_steps
    assert log(metadata={"output_noise_rms": " "}).output_noise_rms is None
    assert log(metadata={"pos_reset": " Yes "}).pos_reset
    assert log(metadata={"counts_per_rev": "1000"}).output[1] == 0.36
    with pytest.raises(LogError, match="begins = 'standing'"):
        _ = log(metadata={"begins": "standing"}).begins_at_rest
    assert [log(metadata={"begins": text}).begins_at_rest for text in ("", "at rest", "moving")] == [None, True, False]
    with pytest.raises(LogError, match="output_average is 'previous'"):
        log(metadata={"output_average": "previous"})


def test_gaps_are_counted_and_the_longest_is_named() -> None:
    made = log(6, time_s=[0.0, 0.25, 0.75, 1.0, 2.0, 2.25], pos=[0, 1, 2, 3, 4, 5])
    assert made.dropped == ("4 ticks are missing in 2 gaps (the longest: 3 ticks after 1 s)",)
    one = log(3, time_s=[0.0, 0.25, 0.75], pos=[0, 1, 2])
    assert one.dropped == ("1 tick is missing in 1 gap (the longest: 1 tick after 0.25 s)",)
    doubtful = log(4, time_s=[0.0, 0.25, 0.5, 0.75], pos=[0, 1, 340, 341])
    assert doubtful.ambiguous_rows.tolist() == [2]
    assert doubtful.dropped[0].startswith("the angle is ambiguous from row 3 (0.5 s) on")
    assert log(1, {"sample_time_s": "0.25"}).dropped == ()


def test_a_value_out_of_its_range_is_told_with_its_row() -> None:
    with pytest.raises(LogError, match=r"c4 = 0\.5 in row 2 is not a whole number in 0\.\.1"):
        log(2, c3=[0.0, 1.0], c4=[0.0, 0.5])
    with pytest.raises(LogError, match=r"duty_pct = 101 in row 5 is not in -100\.01\.\.100\.01"):
        log(duty_pct=[0.0] * 4 + [101.0])
    with pytest.raises(LogError, match=r"pos = -1 in row 1"):
        log(1, pos=[-1])
    assert log(2, c3=[1.0, 0.0], c4=[0.0, 0.0]).mode.tolist() == [1, 0]
    assert log(2, c3=[1.0, 1.0]).mode.tolist() == [1, 1]  # one bit alone says nothing


def test_marks_of_other_systems_at_the_beginning_and_at_line_ends_are_read(tmp_path: Path) -> None:
    plain = b"# target: sim\n\ntime_s,duty_pct,pos\n0,1,2\n0.005,1,3\n"
    for data in (plain, b"\xef\xbb\xbf" + plain, plain.replace(b"\n", b"\r\n")):
        (tmp_path / "a.csv").write_bytes(data)
        made = Log.read(tmp_path / "a.csv")
        assert (made.metadata, len(made), made.columns["pos"].tolist()) == ({"target": "sim"}, 2, [2.0, 3.0])
        assert not made.dropped
    for data, said in ((b"\xef\xbb\xbf", "is empty"), (b"\xef\xbb\xbf \n", "is empty"), (b"a\0b", "holds zero bytes")):
        (tmp_path / "a.csv").write_bytes(data)
        with pytest.raises(LogError, match=said):
            Log.read(tmp_path / "a.csv")


# ---- heads and rows ------------------------------------------------------------------------------------------------


def test_a_head_gives_where_the_rows_begin() -> None:
    text = '#  a : b: c \n##x:y\n\n "time_s" , duty_pct\n1,2\n'
    metadata, names, start, line = read_head(text, Path("x"))
    assert (metadata, names) == ({"a": "b: c", "x": "y"}, ["time_s", "duty_pct"])
    assert (text[start:], line) == ("1,2\n", 5)
    assert read_head("\n\na,b\n1,2\n", Path("x")) == ({}, ["a", "b"], 6, 4)
    with pytest.raises(LogError, match="ends before its column names"):
        read_head("# a: b\ntime_s", Path("x"))


def test_a_row_needs_its_time_its_command_and_one_output() -> None:
    assert needed_columns(["x", "speed_deg_s", "time_s", "pos", "duty_pct", "c3"]) == [
        "time_s",
        "duty_pct",
        "c3",
        "pos",
    ]
    assert needed_columns(["time_s", "speed_m_s", "speed_deg_s"]) == ["time_s", "speed_deg_s"]
    assert needed_columns(["time_s", "duty_pct"]) == ["time_s", "duty_pct"]


def test_a_table_has_two_hundred_columns_at_most() -> None:
    for count, is_read in ((200, True), (201, False)):
        names = [f"c{k}" for k in range(count)]
        line = (",".join("1" * count) + "\n").encode()
        if is_read:
            assert len(parse_rows([line], 1, names, [], 2, "x").columns) == 200
        else:
            with pytest.raises(LogError, match="201 columns, at most 200"):
                parse_rows([line], 1, names, [], 2, "x")


def test_a_tenth_of_the_lines_may_be_broken() -> None:
    def parsed(good: int, bad: int) -> int:
        lines = b"1,2\n" * good + b"1\n" * bad
        return parse_rows([lines], good + bad, ["a", "b"], ["a"], 10, "x").columns["a"].size

    assert [parsed(18, 2), parsed(1, 1), parsed(0, 1)] == [18, 1, 0]
    with pytest.raises(LogError, match=r"x: 2 of 19 lines do not fit the 2 columns \(the first is line 27\)"):
        parsed(17, 2)


def test_text_costs_its_row_where_it_is_needed_and_its_column_elsewhere() -> None:
    lines = [f"{k},{k},t,u,v,w" for k in range(20)]
    lines[3], lines[12] = "x,3,t,u,v,w", "12,y,t,u,v,w"
    pieces = [("\n".join(part) + "\n").encode() for part in (lines[:8], lines[8:])]
    found = parse_rows(pieces, 20, list("abcdef"), ["a", "b"], 5, "x")
    assert found.columns.keys() == {"a", "b"}
    wanted = [float(k) for k in range(20) if k not in (3, 12)]
    assert found.columns["a"].tolist() == found.columns["b"].tolist() == wanted
    assert found.notes == (
        "4 columns that hold text (c, d, e)",
        "2 lines that do not fit the columns (the first is line 8)",
    )


def test_empty_fields_and_lines_and_remarks_are_no_numbers_and_no_faults() -> None:
    found = parse_rows([b",2\n1,\n,\n\n# a remark\n3,4\n"], 6, ["a", "b"], [], 2, "x")
    np.testing.assert_array_equal(found.columns["a"], [np.nan, 1.0, np.nan, 3.0])
    np.testing.assert_array_equal(found.columns["b"], [2.0, np.nan, np.nan, 4.0])
    assert found.notes == ()
    one = parse_rows([b"1\n\n \nx\n#c\n2\n"], 6, ["a"], ["a"], 2, "x")
    assert one.columns["a"].tolist() == [1.0, 2.0]
    assert one.notes == ("1 lines that do not fit the columns (the first is line 5)",)


# ---- writing -------------------------------------------------------------------------------------------------------


def written(*, host_time: bool = False, metadata: Mapping[str, str] | None = None, ending: str = "complete",
            statistics: str = "") -> list[str]:  # fmt: skip
    made = LogWriter(None, metadata or {}, host_time=host_time)
    made.begin(12.3456789, True)
    made.row(1.0 / 3.0, 200.0 / 3.0, 1, 0, 719, 1, 1000.0 / 3.0, -1000.0 / 3.0, 2.0 / 3.0)
    made.row(1.0, 0.0, 1, 1, 0, 0)
    made.close(ending, statistics)
    made.close("never")
    return made.text().splitlines(keepends=True)


def test_a_row_has_nine_digits_and_its_angle_twelve() -> None:
    lines = written(host_time=True)
    names, first, second = (line.strip() for line in lines[-4:-1])
    assert names == "time_s,duty_pct,c3,c4,pos,direction,ref_deg,angle_deg,host_time_s"
    assert first == "0.333333333,66.6666667,1,0,719,1,333.333333,-333.333333333,0.666667"
    assert second == "1,0,1,1,0,0,,,"
    assert written()[-2] == "1,0,1,1,0,0,,\n"
    assert judge("".join(lines).encode()).state == WHOLE


def test_lines_that_are_known_late_have_one_width_whatever_they_say() -> None:
    plain = written()
    for ending, statistics in (("x" * 1000, "y" * 1000), ("ä" * 1000, "€" * 1000), ("a\nb", "c\rd")):
        lines = written(ending=ending, statistics=statistics)
        assert [len(line.encode()) for line in lines[:5]] == [len(line.encode()) for line in plain[:5]]
        assert judge("".join(lines).encode()).state == WHOLE
    assert [len(line.encode()) for line in plain[1:5]] == [241, 481, 41, 21]
    assert [line.strip() for line in plain[1:5]] == [
        "# ending: complete", "# tick_statistics: 2 ticks", "# bench_time_s: 12.345679", "# begins: at rest",
    ]  # fmt: skip
    assert written(metadata={"a": "", "schema": "x", "b" * 80: "c" * 600})[1] == f"# {'b' * 60}: {'c' * 500}\n"
    assert plain[0] == "# schema: fiohost.log/1\n"
    made = LogWriter(None, {})
    made.begin(0.0, False)
    assert "# begins: moving" in made.text()
    assert "# ending: unfinished (the host did not close this log)" in made.text()
    assert "# tick_statistics: unknown" in made.text()


def test_a_line_is_one_line() -> None:
    assert one_line(" a\x00\x1f\x7f\x85\u2028\u2029b\tc ", 10) == "a b c"
    assert one_line("abcdef", 3) == "abc"


def test_a_log_in_memory_alone_gives_its_text_and_a_session_that_keeps_nothing_counts(tmp_path: Path) -> None:
    writer = LogWriter(tmp_path / "a.csv", {})
    with pytest.raises(LogError, match="only a log kept in memory"):
        writer.text()
    writer.close()
    assert writer._file.closed
    seen: list[tuple[object, ...]] = []
    session = NoLog(None, {})
    session.row(1.0)
    session.also = lambda *row: seen.append(row)
    session.row(2.0, 3.0)
    assert (session.rows, seen) == (2, [(2.0, 3.0)])
    also = LogWriter(None, {})
    also.also = lambda *row: seen.append(row)
    also.row(0.0, 1.0, 1, 0, 5, 0)
    assert seen[-1] == (0.0, 1.0, 1, 0, 5, 0, None, None, None)


class Disk(io.BytesIO):
    """A file that takes some bytes at a time, and from a number of bytes on nothing."""

    def __init__(self, most: int, room: int) -> None:
        super().__init__()
        self._most, self._room = most, room

    def write(self, data: Any) -> int:
        if self.tell() + 1 > self._room:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(bytes(data)[: min(self._most, self._room - self.tell())])


def on(disk: Disk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LogWriter:
    monkeypatch.setattr(writing.files, "open_log", lambda path, what: (disk, tmp_path / "a.csv"))
    return LogWriter(tmp_path / "a.csv", {})


def test_a_disk_that_takes_a_part_is_given_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Disk(7, 1 << 20)
    writer = on(disk, tmp_path, monkeypatch)
    writer.row(0.0, 1.0, 1, 0, 5, 0)
    assert disk.getvalue().endswith(b"angle_deg\n0,1,1,0,5,0,,\n")
    assert writer._whole == len(disk.getvalue())


def test_a_full_disk_keeps_whole_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    head = len("".join(written()[:6]).encode())
    disk = Disk(1 << 20, head + 30)
    writer = on(disk, tmp_path, monkeypatch)
    writer.row(0.0, 1.0, 1, 0, 5, 0)
    with pytest.raises(LogError, match="No space left on device; 1 rows are safe in it"):
        writer.row(0.005, 1.0, 1, 0, 5, 0)
    assert disk.getvalue().endswith(b"angle_deg\n0,1,1,0,5,0,,\n")
    small = Disk(1 << 20, 100)
    with pytest.raises(LogError, match="No space left on device; 0 rows"):
        on(small, tmp_path, monkeypatch)
    assert small.closed


def test_a_file_that_cannot_be_brought_to_the_disk_is_closed_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    made: Any = SimpleNamespace(fileno=lambda: 0)
    fails = [errno.EINVAL, errno.ENOTSUP, errno.EROFS, errno.EIO]

    def fsync(fd: int) -> None:
        raise OSError(fails.pop(0), "no")

    monkeypatch.setattr(os, "fsync", fsync)
    for _ in range(3):
        writing._sync(made)
    with pytest.raises(OSError, match="no"):
        writing._sync(made)


class Stuck:
    """A thread behind which *waiting* rows wait, and that ends or does not."""

    def __init__(self, waiting: int, ends: bool) -> None:
        self.waiting, self.problem, self._ends = waiting, None, ends

    def put(self, row: bytes) -> bool:
        return False

    def close(self, limit_s: float) -> bool:
        assert limit_s == 5.0
        return self._ends


def test_a_disk_that_takes_nothing_is_said_while_it_runs_and_when_it_ends(tmp_path: Path) -> None:
    for ends in (True, False):
        writer: Any = LogWriter(tmp_path / f"{ends}.csv", {}, behind=True)
        writer.row(0.0, 1.0, 1, 0, 5, 0)
        writer._behind.close(100.0)
        writer._behind = Stuck(3, ends)
        with pytest.raises(LogError, match="the disk has taken nothing for the last 3 rows; 1 rows are in it"):
            writer.row(0.005, 1.0, 1, 0, 5, 0)
        with pytest.raises(LogError, match="does not answer: 1 rows were handed to it, 3 were not"):
            writer.close()
    assert "# ending: unfinished" in (tmp_path / "False.csv").read_text()


def test_columns_are_written_with_the_shortest_text_that_reads_as_they_are() -> None:
    columns = {"a": np.array([1.0, -0.5, math.nan]), "b": np.array([0.1, 1e22, 3.0])}
    assert rows_text(columns) == b"1,0.1\n-0.5,1e+22\n,3\n"
    text = log_text(columns, {"x": "y", "z": "", "schema": "other"})
    assert text.startswith(b"# schema: fiohost.log/1\n# x: y\na,b\n1,0.1\n")
    assert re.fullmatch(rb"# end: rows=3 crc32_head=[0-9a-f]{8} crc32_rows=[0-9a-f]{8}\n", text.splitlines(True)[-1])
    assert judge(text).state == WHOLE
    assert judge(log_text({}, {})).rows_written == 0


@pytest.mark.parametrize("rows", [33_333, 33_334])
def test_many_columns_are_written_alike(rows: int) -> None:
    """From 100,000 cells on by another way, where that is installed."""
    values = np.arange(rows) * 0.1
    values[7] = math.nan
    columns = {"a": values, "b": values + 0.5, "c": values.round()}
    lines = rows_text(columns).decode().splitlines()
    assert len(lines) == rows
    back = np.array([[float(cell or "nan") for cell in line.split(",")] for line in lines])
    for k, name in enumerate(columns):
        np.testing.assert_array_equal(back[:, k], columns[name])


# ---- whether it is whole -------------------------------------------------------------------------------------------

BODY = b"# host_version: 1\na\n1\n2\n"


def test_what_became_of_a_log_is_told_from_its_bytes() -> None:
    import zlib

    head, rows = b"# host_version: 1\na\n", b"1\n2\n"
    end = end_line(2, zlib.crc32(head), zlib.crc32(rows)).encode()
    assert judge(BODY + end) == judge(BODY + end[:-1])
    assert (judge(BODY + end).state, judge(BODY + end).rows, judge(BODY + end).notes) == (WHOLE, 2, ())
    more = judge(BODY + b"3\n" + end)
    assert (more.state, more.rows, more.rows_written) == (ALTERED, 3, 2)
    assert more.notes == ("1 rows were added: 3 are there, 2 were written", "the rows are not those that were written")
    less = judge(head + b"1\n" + end)
    assert less.notes[0] == "1 rows are missing: 1 are there, 2 were written"
    other = judge(b"# host_version: 2\na\n1\n2\n" + end)
    assert other.notes == ("the head is not the one that was written",)
    assert judge(BODY).state == CUT_OFF
    assert judge(b"# hos").state == UNKNOWN
    assert judge(b"# a: b\n" + BODY).state == CUT_OFF
    assert judge(b"# a: b\na\n1\n").state == UNKNOWN
    assert judge(end).state == UNKNOWN  # it has nothing to be the end of
    assert judge(b"").rows == 0
    assert judge(b"a\n1\n2").rows == 1
    empty = end_line(0, zlib.crc32(head), 0).encode()
    assert (judge(head + empty).state, judge(head + empty).rows) == (WHOLE, 0)
    marked = b"\xef\xbb\xbf# host_version: 1\n\na\n"
    assert judge(marked + rows + end_line(2, zlib.crc32(marked), zlib.crc32(rows)).encode()).state == WHOLE
