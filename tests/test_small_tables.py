"""Tables that people write, cell by cell; and the bounds of what is read and of what waits."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import fiohost
from fiohost import files
from fiohost.bench import table, watcher, writer
from fiohost.bench.table import read_cells
from fiohost.bench.writer import LogWriter
from fiohost.errors import LogError
from fiohost.transport import serial, trace
from fiohost.transport.trace import TraceReader, TraceWriter

# ---- what is bounded -----------------------------------------------------------------------------------------------


def test_no_file_is_read_and_nothing_waits_beyond_its_bound(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A log of 640 MB, a table of 400, a trace of 10 GB; 400 rows, 1000 lines of a trace, 100 ticks that are shown."""
    asked: list[int] = []

    def reads(path: object, most: int, *rest: object) -> bytes:
        asked.append(most)
        raise LogError("seen")

    for name in ("read_input", "open_input"):
        monkeypatch.setattr(files, name, reads)
    for read in (fiohost.read_log, lambda path: read_cells(path, 1), TraceReader):
        with pytest.raises(LogError, match="seen"):
            read("x")  # type: ignore[arg-type]
    assert asked == [640_000_000, 400_000_000, 10_000_000_000]
    monkeypatch.undo()
    asked.clear()
    made: Any = SimpleNamespace(close=lambda limit_s: True, waiting=0, problem=None, put=lambda item: True)
    for module in (writer, trace, watcher):
        monkeypatch.setattr(module, "Background", lambda do, most, name: (asked.append(most), made)[1])
    LogWriter(tmp_path / "a.csv", {}, behind=True).close()
    TraceWriter(tmp_path / "t.jsonl").session({}, 0.0)
    watcher.Watcher(print)
    assert asked == [400, 1, 1000, 100]


def test_no_more_of_a_stream_is_taken_in_one_go_than_a_mebibyte(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    select = SimpleNamespace(select=lambda read, write, wrong, wait_s: (waits.append(wait_s), (read, [], []))[1])
    monkeypatch.setattr(serial, "select", select)
    monkeypatch.setattr(serial, "os", SimpleNamespace(read=lambda fd, size: bytes(size)))
    assert len(serial._read(3, 0.25)) == 1_048_576
    assert (waits[0], set(waits[1:])) == (0.25, {0.0})
    waits.clear()
    serial._read(3, -1.0)
    assert waits[0] == 0.0


# ---- tables that people write --------------------------------------------------------------------------------------


def cells(tmp_path: Path, text: str | bytes, most_rows: int = 10) -> list[dict[str, str]]:
    path = tmp_path / "t.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_cells(path, most_rows)[0]


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " "])
def test_cells_are_split_by_what_gives_most(delimiter: str, tmp_path: Path) -> None:
    text = "# a remark\n\n a{0}b c{0}d \r\n1{0}x{0}2\n".replace("b c", "bc").format(delimiter)
    assert cells(tmp_path, text) == [{"a": "1", "bc": "x", "d": "2"}]


def test_a_table_of_readings_is_as_large_as_is_said(tmp_path: Path) -> None:
    assert len(cells(tmp_path, "a,b\n" + "1,2\n" * 10)) == 10
    with pytest.raises(LogError, match="has more than 10 rows"):
        cells(tmp_path, "a,b\n" + "1,2\n" * 11)
    for text in ("", "a,b\n", "# x\na,b\n"):
        with pytest.raises(LogError, match="at least one row below it"):
            cells(tmp_path, text)
    wide = [f"c{k}" for k in range(1001)]
    assert len(cells(tmp_path, ",".join(wide[:1000]) + "\n" + ",".join("1" * 1000) + "\n")[0]) == 1000
    with pytest.raises(LogError, match="has 1001 columns, more than 1000"):
        cells(tmp_path, ",".join(wide) + "\n" + ",".join("1" * 1001) + "\n")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,a,b\n1,2,3\n", "has 2 columns named 'a': rename"), ("a,b\n1\n", "line 2: 1 cells under 2 column names"),
        ("# x\na,b\n1,2\n1,2,3\n", "line 4: 3 cells under 2"), ("1,2\n3,4\n", "starts with a row of numbers"),
        ('a,b\n"1,2\n', "line 2 cannot be split into cells"), (b"a,b\n1,\0\n", "is not a text table in UTF-8"),
        ("a\n1\n".encode("utf-16"), "is not a text table in UTF-8"), (b"\xfe\xff\0a", "is not a text table"),
    ],
)  # fmt: skip
def test_a_table_that_is_none_is_refused_with_its_line(text: str | bytes, said: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=said):
        cells(tmp_path, text)


def test_cells_may_be_quoted_empty_or_of_another_encoding(tmp_path: Path) -> None:
    assert cells(tmp_path, 'a,b\n"1,5", \n') == [{"a": "1,5", "b": ""}]
    assert cells(tmp_path, b"\xef\xbb\xbfa,b\n\xff,2\n") == [{"a": "\ufffd", "b": "2"}]
    assert cells(tmp_path, "a,1\n2,3\n") == [{"a": "2", "1": "3"}]
    assert cells(tmp_path, ",a\n2,3\n") == [{"": "2", "a": "3"}]
    (tmp_path / "far.csv").write_bytes(b"a,b\n" + b"1,2\n" * 1500 + b"1,\0\n")
    assert len(read_cells(tmp_path / "far.csv", 2000)[0]) == 1501  # only the beginning is looked at for its kind
    one, two = (read_cells(tmp_path / "far.csv", 2000)[1] for _ in range(2))
    assert one == two
    assert len(one) == 64


def test_a_wanted_column_is_there_once() -> None:
    assert table._header("t,u;y", ("u;y",), Path("x")) == (",", ["t", "u;y"])
    assert table._header("t,u;y", ("t,u",), Path("x")) == (";", ["t,u", "y"])
    with pytest.raises(LogError, match="has no column 'v'; "):
        table._header("t,u", ("v",), Path("x"))
    with pytest.raises(LogError, match="has 2 columns named 'u'"):
        table._header("t,u,u", ("u",), Path("x"))
