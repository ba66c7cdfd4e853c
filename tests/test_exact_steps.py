"""What is done at the very tick, byte, call or try: once more or less would go unseen elsewhere."""

from __future__ import annotations

import os
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from boards import WatchedTransport, bench_on
from lines import FakeHidapi, info
from test_exact_bounds import log
from test_hid_line import line

from fiohost.bench import connect as connecting
from fiohost.bench import starts
from fiohost.bench.cable import brake_when_back
from fiohost.bench.clock import VirtualClock
from fiohost.bench.connect import asking, connect
from fiohost.bench.deadband import _start_time
from fiohost.bench.doctor import PROBLEM, timing
from fiohost.bench.guard import MotorGuard
from fiohost.bench.host import HostWatch
from fiohost.bench.log import Log
from fiohost.bench.rest import BRAKE_LIMIT_S, STILL_TICKS
from fiohost.bench.seal import state_dir
from fiohost.bench.turns import Tick
from fiohost.bench.unwrap import ambiguous_steps
from fiohost.bench.watcher import Watcher
from fiohost.errors import DisconnectedError, FiohostError, GuardError, HostError
from fiohost.transport import emulated, hid, serial
from fiohost.transport.base import Way
from fiohost.transport.profile import Guards, TargetProfile
from fiohost.transport.replay import ReplayTransport
from fiohost.transport.timed import TimedTransport
from fiohost.transport.trace import TraceWriter
from fiohost.wire.messages import BRAKE_COMMAND, Command


def test_ten_ticks_of_silence_end_a_run_and_nine_do_not() -> None:
    """50 ms, counted anew after each good report."""

    def silent(first: int, length: int) -> Any:
        return lambda k, report: b"" if first <= k % 100 < first + length else report

    with bench_on(WatchedTransport(on_receive=silent(60, 9))) as bench:
        assert 300 < len(bench.drive(40.0, 2.0)) < 400
    with bench_on(WatchedTransport(on_receive=silent(60, 10))) as bench, pytest.raises(FiohostError):
        bench.drive(40.0, 2.0)
    quiet = WatchedTransport(on_receive=lambda k, report: b"")
    line_ = bench_on(quiet)._line
    for _ in range(2):  # after it was said, the count begins anew
        assert [line_.tick() for _ in range(9)] == [None] * 9
        with pytest.raises(FiohostError):
            line_.tick()


def test_nobody_waits_for_a_lost_board_unasked() -> None:
    with connect("sim") as bench:
        assert bench.reconnect_s == 0.0
    with asking(reconnect_s=3.0), asking(limits={"duty_pct": 50.0}), connect("sim") as bench:
        assert (bench.reconnect_s, bench.profile.limits.duty_pct) == (3.0, 50.0)
    with asking(), connect("sim") as bench:
        assert (bench.reconnect_s, bench.profile.limits.duty_pct) == (0.0, 100.0)


def test_a_pieces_end_is_not_taken_for_the_end_of_what_came(monkeypatch: pytest.MonkeyPatch) -> None:
    read, write = os.pipe()
    os.write(write, bytes(3 * serial.PIECE))
    assert len(serial._read(read, 0.0)) == 3 * serial.PIECE
    monkeypatch.setattr(serial, "MOST_BYTES", serial.PIECE)
    os.write(write, bytes(3 * serial.PIECE))
    assert len(serial._read(read, 0.0)) == serial.PIECE
    os.close(read)
    os.close(write)


def test_a_port_is_waited_on_for_one_byte_and_then_emptied() -> None:
    asked: list[int] = []
    port = SimpleNamespace(timeout=None, in_waiting=6)

    def read(size: int) -> bytes:
        asked.append(size)
        port.in_waiting = 6 if len(asked) == 1 else 0
        return bytes(size)

    port.read = read
    assert len(serial._read_port(port, 0.01)) == 7
    assert asked == [1, 6]
    assert port.timeout == pytest.approx(serial.TIMEOUT_STEP_S)
    serial._read_port(port, -1.0)
    assert port.timeout == 0.0


def test_a_report_is_answered_once() -> None:
    now_s = iter(range(100))
    timed = TimedTransport(WatchedTransport(), lambda: float(next(now_s)))
    timed.open()
    timed.send(bytes(64))
    timed.receive(0.05)
    for _ in range(3):
        timed.send(bytes(64))
    assert timed.answered_s == [1.0]
    timed.receive(0.05)
    timed.send(bytes(64))
    assert timed.answered_s == [1.0, 1.0]


def test_a_trace_waits_for_its_disk_only_where_the_board_waits_for_its_host(tmp_path: Path) -> None:
    at_once, behind = TraceWriter(tmp_path / "a.jsonl"), TraceWriter(tmp_path / "b.jsonl")
    at_once.session({"lock_step": True}, 0.0)
    assert (tmp_path / "a.jsonl").read_text().count("\n") == 1
    behind.session({}, 0.0)
    assert at_once._behind is None
    assert behind._behind is not None
    at_once.close()
    behind.close()


def test_a_replay_is_open_between_open_and_close(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    with asking(trace=path), connect("sim") as bench:
        bench.drive(20.0, 0.1)
    replay = ReplayTransport(path, paced=True)
    with pytest.raises(DisconnectedError, match="closed"):
        replay.send(bytes(64))
    slept: list[float] = []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("fiohost.transport.replay.time", SimpleNamespace(sleep=slept.append, monotonic=lambda: 0.0))
        replay.open()
        replay.send(bytes(64))
        for _ in range(20):
            replay.receive(0.05)
    assert slept[:20] == pytest.approx([0.005 * k for k in range(20)], abs=1e-6)
    replay.close()
    with pytest.raises(DisconnectedError, match="closed"):
        replay.send(bytes(64))


def test_a_hid_board_may_come_back_and_is_the_one_it_was() -> None:
    assert hid.HidTransport.can_reopen
    plain = {k: v for k, v in info(serial="").items() if k != "interface_number"}
    assert hid._same_board(plain, dict(plain))
    assert not hid._same_board({**plain, "interface_number": 1}, plain)
    assert not hid._same_board({**plain, "interface_number": 1}, {**plain, "interface_number": 2})
    assert hid._same_board({**plain, "serial_number": "A"}, {**plain, "serial_number": "A", "path": b"elsewhere"})
    assert not hid._same_board({**plain, "serial_number": "B"}, {**plain, "serial_number": "A"})
    assert not hid._same_board({**plain, "vendor_id": 1}, plain)


def test_reports_that_are_lost_are_a_finding_of_the_doctor() -> None:
    lossy = WatchedTransport(on_receive=lambda k, report: b"" if k % 7 == 0 else report)
    with bench_on(lossy) as bench:
        found = timing(bench)
    said = [finding.what for finding in found.findings if finding.level == PROBLEM]
    assert any("reports were lost or damaged" in what for what in said)


def test_where_a_shaft_started_is_found_from_four_counts_on() -> None:
    """It speeds up evenly from 1.0 s on, and rested half a count before its first edge."""
    time_s = np.arange(0.0, 2.0, 0.001)
    for largest, within_s in ((5, 0.06), (9, 0.06), (3, 0.5)):
        moved = largest * np.clip(time_s - 1.0, 0.0, 1.0) ** 2 * 1.02 + 0.5
        assert _start_time(time_s, np.floor(moved)) == pytest.approx(1.0, abs=within_s)
    assert (
        _start_time(time_s, np.floor(3.06 * np.clip(time_s - 1.0, 0.0, 1.0) ** 2 + 0.5)) > 1.3
    )  # too few to look back


def test_what_a_log_holds_stays_as_it_is() -> None:
    made = log()
    for values in made.columns.values():
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0


def test_a_simulated_shaft_that_stands_is_left_after_a_few_ticks() -> None:
    transport = WatchedTransport()
    with bench_on(transport) as bench:
        bench.drive(0.0, 0.5)
        before = transport.received
    assert transport.received - before == 2 * STILL_TICKS
    assert transport.braked


def test_what_is_kept_for_later_is_in_the_home_where_nothing_else_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("XDG_STATE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    assert state_dir() == tmp_path / ".local" / "state" / "fiohost"
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "elsewhere"))
    assert state_dir() == tmp_path / "elsewhere" / "fiohost"


def test_all_that_came_is_shown_before_a_run_is_over() -> None:
    shown: list[float] = []

    def slowly(tick: Tick) -> None:
        time.sleep(0.02)
        shown.append(tick.time_s)

    watcher = Watcher(slowly)
    for k in range(10):
        watcher(Tick(0.005 * k, BRAKE_COMMAND, 0, 0, 0.0, None))
    watcher.close()
    assert shown == [0.005 * k for k in range(10)]
    failing = Watcher(lambda tick: [][0])
    failing(Tick(0.0, BRAKE_COMMAND, 0, 0, 0.0, None))
    with pytest.raises(IndexError):
        failing.close()


def test_a_board_that_stays_away_is_tried_often_and_given_up_in_time() -> None:
    tried: list[float] = []
    clock = VirtualClock()

    def reopen() -> None:
        tried.append(clock.now_s())
        raise OSError

    line: Any = SimpleNamespace(can_reopen=True, is_known_again=True, reopen=reopen)
    said = brake_when_back(line, lambda: None, OSError("gone"), clock, 1.0, lambda: False)
    assert "it was not back after 1.0 s" in said
    assert 19 <= len(tried) <= 21
    tried.clear()
    assert "waiting" not in brake_when_back(line, lambda: None, OSError("gone"), clock, 0.0, lambda: False)
    assert not tried
    assert "MAY BE RUNNING" in brake_when_back(line, lambda: None, OSError("gone"), clock, 9.0, lambda: True)
    assert not tried


def test_a_simulated_shaft_that_turns_on_is_braked_for_a_while() -> None:
    def turning(k: int, report: bytes) -> bytes:
        return report[:1] + (2 * k % 720).to_bytes(2, "little") + report[3:]

    transport = WatchedTransport(on_receive=turning)
    bench = bench_on(transport)
    before = transport.received
    bench.close()
    assert 0.4 * BRAKE_LIMIT_S <= 0.005 * (transport.received - before) <= BRAKE_LIMIT_S
    assert transport.braked


def test_a_wrong_way_is_measured_from_the_furthest_place() -> None:
    """In both directions, wherever on the turn the run began."""
    for sign in (1.0, -1.0):
        for begin_deg in (0.0, 1000.0, -1000.0):
            guard = MotorGuard(Guards(), 0.005, 720)
            angle = begin_deg
            for k in range(400):
                angle += sign * (2.0 if k < 100 else -2.5)  # 200 deg on, then back
                try:
                    guard.check(k, Command.drive(sign * 50.0), angle)
                except GuardError:
                    break
            back_deg = abs(angle - (begin_deg + sign * 200.0))
            assert 180.0 < back_deg < 184.0, (sign, begin_deg)


def test_a_hid_board_tells_its_guardian_the_way_while_it_is_open() -> None:
    module = FakeHidapi(info(path="/dev/hidraw9"))
    board = line(module)
    assert board.way is None
    with board:
        assert board.way == Way(path="/dev/hidraw9", prefix=b"\0")
    assert board.way is None
    module = FakeHidapi(info())
    with line(module) as board:
        assert board.way is None  # a module without a name cannot be loaded by the guardian
    module.__name__ = "fakehid"  # type: ignore[attr-defined]
    with line(module) as board:
        assert board.way == Way(path="1-2:1.0", module="fakehid", prefix=b"\0")


def test_the_seed_of_an_emulated_board_is_kept_where_the_board_is_sealed(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: dict[str, int] = {}
    monkeypatch.setattr(emulated, "emulated_board", lambda rest, seed: (rest, seed))
    monkeypatch.setattr(connecting, "store_seed", kept.__setitem__)
    profile = TargetProfile.load()
    assert connecting._emulated("uno", profile, None, "plain") == ("uno", None)
    assert connecting._emulated("uno:sealed", profile, 7, "told") == ("uno:sealed", 7)
    rest, drawn = connecting._emulated("uno:sealed", profile, None, "drawn")  # type: ignore[misc]
    assert kept == {"told": 7, "drawn": drawn}
    assert (rest, type(drawn)) == ("uno:sealed", int)


def test_a_controller_is_ended_when_two_and_a_half_gaps_have_passed(monkeypatch: pytest.MonkeyPatch) -> None:
    set_s: list[float] = []
    monkeypatch.setattr("signal.setitimer", lambda which, seconds: set_s.append(seconds))
    clock = SimpleNamespace(real=True, now_s=lambda: 0.0)
    profile = SimpleNamespace(guards=Guards(gap_s=0.2))
    made: Any = SimpleNamespace(clock=clock, guardian=None, profile=profile, transport=SimpleNamespace(can_reopen=True))
    watch = HostWatch(made)
    watch.turn()
    with watch.alarmed():
        watch.turn()
        watch.turn()
    assert set_s == [0.5, 0.5, 0.5, 0.0]  # before the first step too
    watch.turn()
    assert len(set_s) == 4


def test_a_loop_that_came_back_late_ends_the_run_beyond_the_gap_and_not_at_it() -> None:
    now_s = [0.0]
    clock = SimpleNamespace(real=True, now_s=lambda: now_s[0])
    profile = SimpleNamespace(guards=Guards(gap_s=0.25))
    made: Any = SimpleNamespace(clock=clock, guardian=None, profile=profile, transport=SimpleNamespace(can_reopen=True))
    watch = HostWatch(made)
    now_s[0] = 0.25
    watch.turn()
    now_s[0] = 0.5
    watch.turn()
    now_s[0] = 0.76
    with pytest.raises(HostError, match=r"held fiohost up for 0\.26 s"):
        watch.turn()


def test_the_steps_of_one_start_stand_behind_each_other_and_begin_at_rest() -> None:
    def log(angles: list[int]) -> Log:
        rows = len(angles)
        columns = {"time_s": [0.005 * k for k in range(rows)], "duty_pct": [float(rows)] * rows, "pos": angles}
        return Log.from_columns(columns, {"sample_time_s": "0.005"})

    found = starts._onset([log([10, 12, 14]), log([20, 24, 28, 32])], 4.0, True)
    assert found.moved_deg.tolist() == [0.0, 1.0, 2.0, 5.0, 7.0, 9.0, 11.0]
    assert found.time_s == pytest.approx([0.005 * k for k in range(7)])
    assert (found.onset_s, found.at_angle_deg) == (pytest.approx(0.015), 10.0)


@pytest.mark.parametrize("most_pct", [100.0, 6.0])
def test_a_start_lies_on_the_line_through_the_two_steps_that_turned(
    most_pct: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A shaft that turns 8 deg a step and percent above 5.1 %; where no larger step is allowed, the step itself."""
    asked: list[float] = []

    def play(program: Any) -> Any:
        duty = program.step(0, 0.0)[0].duty_pct
        asked.append(duty)
        return SimpleNamespace(output=np.array([0.0, 8.0 * max(0.0, duty - 5.1)]))

    monkeypatch.setattr(starts, "_onset", lambda logs, duty_pct, forward: (len(logs), duty_pct))
    bench: Any = SimpleNamespace(sample_time_s=0.005, counts_per_rev=720, play=play)
    tried, found = starts.step_until_it_starts(bench, True, 4.0, most_pct)  # type: ignore[misc]
    assert asked[: int(tried)] == [4.0, 4.25, 4.5, 4.75, 5.0, 5.25, 5.5]
    assert asked[int(tried) :] == ([6.5] if most_pct == 100.0 else [])
    assert found == pytest.approx(5.1 if most_pct == 100.0 else 5.5)


def test_a_gap_is_more_than_one_and_a_half_ticks() -> None:
    pos = np.array([0.0, 230.0, 460.0, 461.0])
    for gap_s, doubtful in ((0.75, []), (0.76, [1])):
        time_s = np.cumsum([0.0, 0.5, gap_s, 0.5])
        assert ambiguous_steps(pos, time_s, 0.5, 720).tolist() == doubtful
