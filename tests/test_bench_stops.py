"""The bench: every way out of a run leaves the motor braked, and the log whole."""

from __future__ import annotations

import os
import resource
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from boards import HANG_S, Receive, WatchedTransport, bench_on, rows_of
from places import PACKAGES
from test_bench import STAIRS

from fiohost.bench.log import Log
from fiohost.bench.loop import Tick
from fiohost.bench.program import Answer
from fiohost.bench.stop import Stopped
from fiohost.errors import (
    DisconnectedError,
    FiohostError,
    LimitError,
    LogError,
    ReportError,
    TelemetryTimeoutError,
)
from fiohost.wire.messages import Command


class FailingController:
    """A program that drives, and fails at tick 100 in the way it is told."""

    def __init__(self, failure: BaseException | Command) -> None:
        self.failure = failure

    def step(self, k: int, angle_deg: float) -> Answer:
        if k == 100:
            if isinstance(self.failure, BaseException):
                raise self.failure
            return self.failure, None
        return Command.drive(50.0), None


def test_an_exception_in_a_controller_brakes_first_and_leaves_a_whole_log(tmp_path: Path) -> None:
    board, path = WatchedTransport(), tmp_path / "run.csv"
    bench = bench_on(board)
    with pytest.raises(ZeroDivisionError) as caught:
        bench.play(FailingController(ZeroDivisionError("division by zero")), path)
    assert board.braked
    log = Log.read(path)
    assert len(log) == 100
    assert log.dropped == ()
    assert log.metadata["ending"] == "stopped: ZeroDivisionError: division by zero"
    assert any("100 rows" in note for note in caught.value.__notes__)


def test_the_braked_board_really_stops_and_can_be_used_again() -> None:
    bench = bench_on(WatchedTransport())
    with pytest.raises(ZeroDivisionError):
        bench.play(FailingController(ZeroDivisionError()))
    log = bench.drive(0.0, 0.5)
    assert np.ptp(log.output) == 0.0


@pytest.mark.parametrize("duty_pct", [np.nan, 100.5, -1e9, np.inf])
def test_a_controller_that_asks_for_nonsense_is_stopped(duty_pct: float, tmp_path: Path) -> None:
    class Nonsense:
        def step(self, k: int, angle_deg: float) -> Answer:
            return Command.drive(duty_pct if k == 20 else 20.0), None

    board = WatchedTransport()
    with pytest.raises(LimitError, match="cannot be sent"):
        bench_on(board).play(Nonsense(), tmp_path / "run.csv")
    assert board.braked
    assert len(Log.read(tmp_path / "run.csv")) == 20


def _pos_beyond_the_turn(k: int, report: bytes) -> bytes:
    return struct.pack("<BH", 0, 40_000) + report[3:] if k >= 60 else report


def _short_report(k: int, report: bytes) -> bytes:
    return report[:17] if k >= 60 else report


def _silence(k: int, report: bytes) -> bytes:
    if k >= 60:
        raise TelemetryTimeoutError("nothing came")
    return report


@pytest.mark.parametrize(
    ("fault", "error"),
    [(_pos_beyond_the_turn, ReportError), (_short_report, ReportError), (_silence, TelemetryTimeoutError)],
)
def test_bad_reports_or_silence_for_50_ms_brake_and_are_named(
    fault: object, error: type[FiohostError], tmp_path: Path
) -> None:
    board = WatchedTransport(on_receive=fault)  # type: ignore[arg-type]
    with pytest.raises(error):
        bench_on(board).drive(50.0, 5.0, tmp_path / "run.csv")
    assert board.braked
    log = Log.read(tmp_path / "run.csv")
    assert 0 < len(log) < 60
    assert error.__name__ in log.metadata["ending"]


@pytest.mark.parametrize("fault", [_pos_beyond_the_turn, _short_report, _silence])
def test_a_few_bad_reports_are_missing_rows_and_the_run_goes_on(fault: Receive, tmp_path: Path) -> None:
    """Nothing is answered to a report that cannot be one: the board holds, the log has no row, the ending says so."""
    bad = range(100, 109)
    board = WatchedTransport(on_receive=lambda k, report: fault(60, report) if k in bad else report)
    with bench_on(board) as bench:
        log = bench.drive(50.0, 1.0, tmp_path / "run.csv")
        sent = len(board.sent)
    assert board.braked
    ticks = np.rint(log.time_s / 0.005).astype(int)
    missing = sorted(set(range(200)) - set(ticks))
    assert len(missing) == len(bad)
    assert missing == list(range(missing[0], missing[0] + len(bad)))
    assert log.metadata["ending"] == "complete"
    assert f"{len(bad)} " in log.metadata["tick_statistics"]
    assert "9 ticks are missing in 1 gap" in log.dropped[0]
    assert np.abs(np.diff(log.output)[20:]).max() > 15.0  # the shaft ran on through the gap
    assert sent < 400


def test_a_board_that_went_away_is_said_to_be_perhaps_running(tmp_path: Path) -> None:
    def unplug(k: int, report: bytes) -> bytes:
        if k == 60:
            board.close()
            raise DisconnectedError("the board was unplugged")
        return report

    board = WatchedTransport(on_receive=unplug)
    with pytest.raises(DisconnectedError, match="unplugged") as caught, bench_on(board) as bench:
        bench.drive(50.0, 5.0, tmp_path / "run.csv")
    assert any("MOTOR MAY BE RUNNING" in note for note in caught.value.__notes__)
    assert len(Log.read(tmp_path / "run.csv")) > 0


def test_progress_that_fails_brakes_too() -> None:
    def closed_terminal(tick: Tick) -> None:
        raise BrokenPipeError

    board = WatchedTransport()
    with pytest.raises(BrokenPipeError):
        bench_on(board).drive(50.0, 5.0, progress=closed_terminal)
    assert board.braked


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_a_signal_stops_between_two_ticks_and_brakes(name: str, code: int, tmp_path: Path) -> None:
    board, path = WatchedTransport(), tmp_path / "run.csv"

    def knock(tick: Tick) -> None:
        if tick.time_s == 1.0:
            os.kill(os.getpid(), getattr(signal, name))

    before = signal.getsignal(getattr(signal, name))
    with pytest.raises(Stopped) as caught:
        bench_on(board).drive(50.0, log_path=path, progress=knock)
    assert caught.value.exit_code == code
    assert isinstance(caught.value, KeyboardInterrupt)
    assert board.braked
    assert len(Log.read(path)) == 201
    assert Log.read(path).metadata["ending"].startswith("stopped by")
    assert signal.getsignal(getattr(signal, name)) is before


def test_a_second_ctrl_c_ends_a_controller_that_hangs() -> None:
    class Hanging:
        def step(self, k: int, angle_deg: float) -> Answer:
            while k == 50:
                os.kill(os.getpid(), signal.SIGINT)
                knocks.append(k)
            return Command.drive(50.0), None

    knocks: list[int] = []
    board = WatchedTransport()
    with pytest.raises(Stopped):
        bench_on(board).play(Hanging())
    assert len(knocks) == 1  # the first one is only asked for; the second does not come back from its call
    assert board.braked


def test_leaving_the_bench_brakes() -> None:
    board = WatchedTransport()
    with bench_on(board) as bench:
        bench.transport.send(bench.profile.codec.encode(Command.drive(50.0)))
    assert board.braked


def test_an_unwritable_log_is_refused_before_anything_moves(tmp_path: Path) -> None:
    board = WatchedTransport()
    with pytest.raises(LogError, match="nothing was driven"):
        bench_on(board).run(STAIRS, tmp_path / "no" / "such" / "folder.csv")
    assert board.sent == []


def test_a_full_disk_in_mid_run_brakes_and_keeps_the_rows(tmp_path: Path) -> None:
    board, path = WatchedTransport(), tmp_path / "run.csv"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (8000, before[1]))
    try:
        with pytest.raises(LogError, match="rows are safe in it"):
            bench_on(board).run(STAIRS, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert board.braked
    assert len(Log.read(path)) > 50


def test_after_kill_9_the_log_holds_every_row_but_the_last(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    command = [sys.executable, "-m", "fiohost.cli.main", "manual", "--pwm", "40", "--log", str(path)]
    host = subprocess.Popen(command, stdout=subprocess.DEVNULL, cwd=PACKAGES)
    deadline = time.monotonic() + HANG_S
    while time.monotonic() < deadline and (not path.exists() or len(rows_of(path)) < 50):
        time.sleep(0.02)
    host.kill()
    host.wait()
    seen = rows_of(path)
    log = Log.read(path)
    assert len(log) >= len(seen) - 1 >= 49
    assert log.metadata["ending"].startswith("unfinished")
    assert log.metadata["command_delay_ticks"] == "1"
