"""The log: what is written comes back, and no file, however damaged, is read as something that it is not."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fiohost.bench.log import BRAKE, DRIVE, STANDBY, Log, LogWriter
from fiohost.errors import LogError

HEAD = "# schema: fiohost.log/1\n# sample_time_s: 0.005\ntime_s,duty_pct,c3,c4,pos,direction,ref_deg,angle_deg\n"


def text_of(pos: list[int], head: str = HEAD) -> str:
    rows = [f"{k * 0.005:.9g},40,1,0,{p},0,,{p / 2:g}\n" for k, p in enumerate(pos)]
    return head + "".join(rows)


def test_a_written_log_comes_back_with_its_numbers_and_metadata(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    with LogWriter(path, {"target": "sim", "sample_time_s": "0.005", "command_delay_ticks": "1"}) as writer:
        writer.row(0.0, 33.29999923706055, 1, 0, 0, 0, None, 0.0)
        writer.row(0.005, 0.0, 1, 1, 719, 1, 180.0, -0.5)
        writer.row(0.010, 0.0, 0, 0, 717, 1, 180.0, -1.5)
        writer.row(0.015, -100.0, 0, 1, 716, 1, 180.0, -2.0)
    log = Log.read(path)
    assert log.dropped == ()
    assert (log.metadata["target"], log.metadata["ending"]) == ("sim", "complete")
    assert (log.sample_time_s, log.command_delay_ticks, log.counts_per_rev, log.pos_reset) == (0.005, 1, 720, False)
    np.testing.assert_array_equal(log.mode, [DRIVE, BRAKE, STANDBY, DRIVE])
    np.testing.assert_array_equal(log.duty_pct.astype(np.float32), np.array([33.3, 0.0, 0.0, -100.0], dtype=np.float32))
    np.testing.assert_array_equal(log.output, [0.0, -0.5, -1.5, -2.0])
    np.testing.assert_array_equal(log.output, log.columns["angle_deg"])
    assert (log.output_name, log.output_unit, log.output_quantum, log.output_average) == (
        "angle_deg", "deg", 0.5, "instant",
    )  # fmt: skip
    assert np.isnan(log.columns["ref_deg"][0])


@pytest.mark.parametrize("behind", [True, False])
def test_rows_of_a_real_board_are_written_by_a_thread_of_their_own(
    behind: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that freezes must not hold up the loop; a simulated board waits for it."""
    writers = []
    write = LogWriter._write_row
    monkeypatch.setattr(
        LogWriter, "_write_row", lambda self, row: (writers.append(threading.current_thread()), write(self, row))[1]
    )
    writer = LogWriter(tmp_path / "run.csv", {}, behind=behind)
    writer.row(0.0, 1.0, 1, 0, 5, 0)
    writer.close()
    assert [thread is threading.main_thread() for thread in writers] == [not behind]


def test_a_log_that_was_never_closed_holds_every_row_written(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    writer = LogWriter(path, {"sample_time_s": "0.005"})
    for k in range(10):
        writer.row(k * 0.005, 10.0, 1, 0, k, 0)
    log = Log.read(path)  # the writer is still open, as after kill -9
    assert len(log) == 10
    assert log.metadata["ending"].startswith("unfinished")
    writer.close()


def test_a_value_in_the_metadata_cannot_forge_a_line(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    with LogWriter(path, {"sample_time_s": "0.005", "target": "a\n# pos_reset: true\n9,9,9"}) as writer:
        writer.row(0.0, 0.0, 1, 1, 0, 0)
    assert not Log.read(path).pos_reset
    assert len(Log.read(path)) == 1


@pytest.mark.parametrize("place", ["no/such/folder/run.csv", "."])
def test_an_unwritable_log_is_refused_in_one_sentence(tmp_path: Path, place: str) -> None:
    with pytest.raises(LogError, match="cannot write the log"):
        LogWriter(tmp_path / place, {})


def test_a_file_cut_off_in_mid_line_gives_its_whole_rows_and_says_what_it_dropped(tmp_path: Path) -> None:
    path = tmp_path / "cut.csv"
    path.write_text(text_of([0, 1, 2, 3])[:-4])
    log = Log.read(path)
    assert len(log) == 3
    assert any("cut off" in note for note in log.dropped)


def test_a_tail_of_zero_bytes_after_a_crash_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "zeros.csv"
    path.write_bytes(text_of([0, 1, 2]).encode() + b"\0" * 512)
    log = Log.read(path)
    assert len(log) == 3
    assert "512 zero bytes" in log.dropped[0]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("", "is empty"),
        ("\n\n", "is empty"),
        ("# schema: fiohost.log/1\n", "ends before its column names"),
        (HEAD, "holds no whole row"),
        (HEAD + "0,40,1,0,3", "holds no whole row"),
        ("t,u,y\n0,1,2\n", "no column 'time_s'"),
        ("time_s,duty_pct\n0,1\n", "no output column"),
        ("time_s,duty_pct,pos,pos\n0,1,2,2\n", "'pos' is there twice"),
        (text_of([0, 1, 720]), "pos = 720 in row 3"),
        (text_of([0, 1]) + "0.01,40,1,0,1.5,0,,\n", "pos = 1.5 in row 3"),
        (text_of([0, 1]) + "0.01,140,1,0,1,0,,\n", "duty_pct = 140"),
        (text_of([0, 1]) + "0.01,40,2,0,1,0,,\n", "c3 = 2"),
        (text_of([0, 1]) + "0.001,40,1,0,1,0,,\n", "runs backwards at row 3"),
        (text_of([0, 1]) + "1e12,40,1,0,1,0,,\n", "time column is broken"),
        (text_of([0, 1]).replace("fiohost.log/1", "fiohost.log/9"), "schema is 'fiohost.log/9'"),
        (text_of([0, 1]).replace("0.005\n", "soon\n", 1), "sample_time_s = 'soon'"),
        (text_of([0, 1]).replace("0.005\n", "0.5\n", 1), "one is wrong"),
        (HEAD + "hello\nworld\nthis\nis\nno\nlog\n", "do not fit"),
        ("x" * 50_000 + "\n1\n", "longer than"),
        ("\0\0\0\0hello\n1,2\n", "zero bytes"),
    ],
)
def test_what_nobody_could_use_is_refused_with_its_reason(tmp_path: Path, content: str, reason: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(content)
    with pytest.raises(LogError, match=reason) as caught:
        Log.read(path)
    assert "\n" not in str(caught.value)


def test_bytes_that_are_no_text_and_files_that_are_not_there_are_refused(tmp_path: Path) -> None:
    (tmp_path / "noise.csv").write_bytes(b"time_s,duty\xff\xfe\n" * 30)
    with pytest.raises(LogError, match="UTF-8"):
        Log.read(tmp_path / "noise.csv")
    with pytest.raises(LogError, match="No such file"):
        Log.read(tmp_path / "absent.csv")
    with pytest.raises(LogError, match="directory"):
        Log.read(tmp_path)


def test_missing_metadata_extra_columns_and_windows_line_ends_are_accepted() -> None:
    log = Log.parse('time_s,note,duty_pct,speed_deg_s\r\n0,hello,10,1\r\n0.02,"x",10,2\r\n0.04,,10,3\r\n')
    np.testing.assert_array_equal(log.output, [1.0, 2.0, 3.0])
    assert (log.output_name, log.output_unit, log.output_quantum) == ("speed_deg_s", "deg/s", 0.0)
    assert log.sample_time_s == pytest.approx(0.02)
    np.testing.assert_array_equal(log.mode, [DRIVE] * 3)
    assert log.dropped == ("1 columns that hold text (note)",)


def test_rows_without_numbers_are_left_out_and_counted() -> None:
    text = text_of(list(range(40))) + "0.2,nan,1,0,40,0,,\n0.205,40,1,0,,0,,\n0.21,40,1,0,ten,0,,\n0.215,40,1,0\n"
    log = Log.parse(text + "0.22,40,1,0,44,0,,\n")
    assert len(log) == 41
    assert log.output[-1] == 22.0
    said = " | ".join(log.dropped)
    assert "2 rows with missing or infinite numbers" in said
    assert "2 lines that do not fit the columns (the first is line 46)" in said
    assert "4 ticks are missing" in said


def test_a_gap_of_missing_ticks_stays_a_gap_and_is_said() -> None:
    lines = text_of(list(range(100))).splitlines(keepends=True)
    log = Log.parse("".join(lines[:33] + lines[38:]))
    assert len(log) == 95
    assert log.tick[-1] == 99
    assert log.dropped == ("5 ticks are missing in 1 gap (the longest: 5 ticks after 0.145 s)",)
    assert log.output[-1] == 49.5


def test_a_repeated_tick_is_counted_once() -> None:
    lines = text_of([0, 1, 2, 3]).splitlines(keepends=True)
    log = Log.parse("".join([*lines[:5], lines[4], *lines[5:]]))
    assert len(log) == 4
    assert "repeat the time" in log.dropped[0]


@pytest.mark.parametrize("speed", [7, -7, 330, -330])
def test_the_angle_runs_through_zero_both_ways_without_a_jump(speed: int) -> None:
    total = 100 + speed * np.arange(50)
    log = Log.parse(text_of([int(p) for p in total % 720]))
    np.testing.assert_array_equal(log.output, total / 2)


def test_a_gap_in_which_the_shaft_may_have_made_a_turn_is_flagged() -> None:
    total = 20 * np.arange(100)  # 20 counts per tick: half a turn in 18 ticks
    lines = text_of([int(p) for p in total % 720]).splitlines(keepends=True)
    short, long = "".join(lines[:40] + lines[44:]), "".join(lines[:40] + lines[63:])
    assert Log.parse(short).ambiguous_rows.size == 0
    flagged = Log.parse(long)
    np.testing.assert_array_equal(flagged.ambiguous_rows, [37])
    assert "ambiguous from row 38" in flagged.dropped[-1]


def test_arrays_in_memory_make_the_same_log_as_a_file() -> None:
    columns = {"time_s": np.arange(5) * 0.01, "duty_pct": np.zeros(5), "angle_deg": np.arange(5.0)}
    log = Log.from_columns(columns, {"output_quantum": "0.5"})
    assert (log.sample_time_s, log.output_quantum, len(log)) == (0.01, 0.5, 5)
    assert log.sha256 != Log.from_columns({**columns, "duty_pct": np.ones(5)}).sha256
    with pytest.raises(LogError, match="one length"):
        Log.from_columns({**columns, "duty_pct": np.zeros(4)})


def test_a_log_of_several_megabytes_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    path.write_text(text_of([int(p) for p in (7 * np.arange(100_000)) % 720]))
    assert path.stat().st_size > 2_000_000
    assert len(Log.read(path)) == 100_000


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_any_damage_to_a_log_is_either_read_or_refused_by_a_log_error(data: st.DataObject) -> None:
    raw = bytearray(text_of(list(range(30))).encode())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(raw) - 1))
        raw[at : at + data.draw(st.integers(0, 8))] = data.draw(st.binary(max_size=8))
        if not raw:
            break
    try:
        log = Log.parse(bytes(raw).decode("utf-8", errors="replace"))
        assert np.all(np.isfinite(log.output))
        assert len(log.output) == len(log.mode) == len(log)
        assert np.all(np.diff(log.time_s) > 0)
        _ = log.ambiguous_rows, log.tick
    except LogError:
        pass


@pytest.mark.parametrize(("told", "means"), [("at rest", True), ("moving", False), (None, None), ("perhaps", LogError)])
def test_how_a_log_begins_is_one_of_two_things_or_not_said(told: str | None, means: bool | type | None) -> None:
    columns = {"time_s": 0.005 * np.arange(5), "duty_pct": np.zeros(5), "angle_deg": np.zeros(5)}
    log = Log.from_columns(columns, {} if told is None else {"begins": told})
    if means is LogError:
        with pytest.raises(LogError, match="'perhaps', which is neither 'at rest' nor 'moving'"):
            _ = log.begins_at_rest
    else:
        assert log.begins_at_rest is means
