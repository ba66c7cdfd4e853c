"""A log to the last number: what its reader bounds, counts and says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fiohost.bench import rows
from fiohost.bench.head import needed_columns, read_head
from fiohost.bench.log import Log
from fiohost.bench.rows import Rows, parse_rows
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


def test_a_log_is_equal_to_itself_alone() -> None:
    """What it holds is arrays: logs stand in sets and are keys by what they are."""
    one, other = log(), log()
    assert one == one
    assert one != other
    assert len({one, other, one}) == 2


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


def rows_of(data: bytes, names: list[str], needed: list[str], first_line: int) -> Rows:
    return parse_rows(data, 0, len(data), names, needed, first_line, "x")


def test_a_table_has_two_hundred_columns_at_most() -> None:
    for count, is_read in ((200, True), (201, False)):
        names = [f"c{k}" for k in range(count)]
        line = (",".join("1" * count) + "\n").encode()
        if is_read:
            assert len(rows_of(line, names, [], 2).columns) == 200
        else:
            with pytest.raises(LogError, match="201 columns, at most 200"):
                rows_of(line, names, [], 2)


def test_a_tenth_of_the_lines_may_be_broken() -> None:
    def parsed(good: int, bad: int) -> int:
        lines = b"1,2\n" * good + b"1\n" * bad
        return rows_of(lines, ["a", "b"], ["a"], 10).columns["a"].size

    assert [parsed(18, 2), parsed(1, 1), parsed(0, 1)] == [18, 1, 0]
    with pytest.raises(LogError, match=r"x: 2 of 19 lines do not fit the 2 columns \(the first is line 27\)"):
        parsed(17, 2)


def test_text_costs_its_row_where_it_is_needed_and_its_column_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows, "PIECE_BYTES", 80)  # a few lines each
    lines = [f"{k},{k},t,u,v,w" for k in range(20)]
    lines[3], lines[12] = "x,3,t,u,v,w", "12,y,t,u,v,w"
    found = rows_of(("\n".join(lines) + "\n").encode(), list("abcdef"), ["a", "b"], 5)
    assert found.columns.keys() == {"a", "b"}
    wanted = [float(k) for k in range(20) if k not in (3, 12)]
    assert found.columns["a"].tolist() == found.columns["b"].tolist() == wanted
    assert found.notes == (
        "4 columns that hold text (c, d, e)",
        "2 lines that do not fit the columns (the first is line 8)",
    )


def test_empty_fields_and_lines_and_remarks_are_no_numbers_and_no_faults() -> None:
    found = rows_of(b",2\n1,\n,\n\n# a remark\n3,4\n", ["a", "b"], [], 2)
    np.testing.assert_array_equal(found.columns["a"], [np.nan, 1.0, np.nan, 3.0])
    np.testing.assert_array_equal(found.columns["b"], [2.0, np.nan, np.nan, 4.0])
    assert found.notes == ()
    one = rows_of(b"1\n\n \nx\n#c\n2\n", ["a"], ["a"], 2)
    assert one.columns["a"].tolist() == [1.0, 2.0]
    assert one.notes == ("1 lines that do not fit the columns (the first is line 5)",)
