"""Rows of large logs by pyarrow: the same numbers as without it, and what it refuses is read with care."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from fiohost.bench import rows as rows_of
from fiohost.bench.log import Log
from fiohost.errors import LogError

HEAD = b"# schema: fiohost.log/1\n# sample_time_s: 0.005\ntime_s,duty_pct,pos,ref_deg\n"
END = b"# the end\n"
ODD = ["1e-320", "-0.0", "12.345678901234567", "1.7976931348623157e308", "7", "", "nan", " 3.5", "0.1"]


def lines(count: int) -> list[bytes]:
    """Numbers of every kind in a column that nobody needs."""
    return [f"{0.005 * k:.9g},{(k % 160) - 80},{k % 720},{ODD[k % len(ODD)]}\n".encode() for k in range(count)]


@pytest.fixture
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is large is small here, so that a test of a few thousand rows meets it, in several pieces."""
    monkeypatch.setattr(rows_of, "LARGE_BYTES", 100)
    monkeypatch.setattr(rows_of, "PIECE_BYTES", 20_000)


def read(path: Path, body: bytes) -> Log:
    path.write_bytes(HEAD + body)
    return Log.read(path)


def test_pyarrow_reads_the_same_numbers(tmp_path: Path, small_pieces: None, monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[bool] = []
    large = rows_of._large
    monkeypatch.setattr(rows_of, "_large", lambda *args: taken.append((found := large(*args)) is not None) or found)
    body = b"".join([*lines(3000), END])
    fast = read(tmp_path / "log.csv", body)
    assert len(taken) > 2
    assert all(taken)
    monkeypatch.setitem(sys.modules, "pyarrow", None)  # as where it is not installed
    slow = read(tmp_path / "log.csv", body)
    assert not all(taken)
    assert len(fast) == len(slow) == 3000
    for name in fast.columns:
        np.testing.assert_array_equal(fast.columns[name], slow.columns[name])
    assert fast.dropped == slow.dropped


@pytest.mark.parametrize(
    "odd",
    [
        b"7.4975,1,2\n", b"1,2,3,4,5\n", b"7.4975,x,2,3\n", b'7.4975,"1",2,3\n', b"# a, b, c, d\n", b"\n",
        b"7.4975,1_0,2,3\n", b"7.4975,+1,2,3\n", b"7.4975,0x10,2,3\n", b"7.4975,NULL,2,3\n", b"7.4975,1,2,text\n",
        b"7.4975,1\r,2,3\n",
    ],
)  # fmt: skip
def test_what_is_not_clean_is_read_as_without_pyarrow(
    odd: bytes, tmp_path: Path, small_pieces: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = lines(2000)
    body.insert(1500, odd)
    with_it = read(tmp_path / "log.csv", b"".join(body))
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    without = read(tmp_path / "log.csv", b"".join(body))
    assert with_it.dropped == without.dropped
    assert with_it.columns.keys() == without.columns.keys()
    for name in with_it.columns:
        np.testing.assert_array_equal(with_it.columns[name], without.columns[name])


@pytest.mark.parametrize(("place", "line"), [(1500, b"0.1,\xff,2,3\n"), (2000, b"# x:\xff\n")])
def test_a_byte_that_is_no_text_is_told_by_its_place(
    place: int, line: bytes, tmp_path: Path, small_pieces: None
) -> None:
    body = lines(2000)
    body[place : place + 1] = [line]
    at = len(HEAD) + len(b"".join(body[:place])) + 4
    with pytest.raises(LogError, match=f"byte {at} is not UTF-8"):
        read(tmp_path / "log.csv", b"".join(body))
