"""What the writers of a log put where, on disks of every kind; and whether it is whole."""

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
from fiohost.bench.integrity import ALTERED, CUT_OFF, UNKNOWN, WHOLE, end_line, judge
from fiohost.bench.log import LogWriter
from fiohost.bench.table_log import log_text, rows_text
from fiohost.bench.writer import NoLog, one_line
from fiohost.errors import LogError

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
