"""The line tick by tick, with a clock and a board that do what a test says."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from test_framing import numbered

from fiohost.bench.clock import Clock
from fiohost.bench.line import Line
from fiohost.errors import (
    ReportError,
    TelemetryTimeoutError,
)
from fiohost.transport.base import Transport
from fiohost.transport.profile import TargetProfile
from fiohost.wire.messages import Command

TICK_S = 2.0**-7  # sums of it are exact
PLAIN = replace(TargetProfile.load("hid-assumed"), sample_time_s=TICK_S)
STREAM = replace(TargetProfile.load("serial-framed"), sample_time_s=TICK_S)
GOOD = bytes(64)
BAD = bytes(63)


class HandClock(Clock):
    """Time that a test moves; what waits is as late as it says."""

    def __init__(self, *, real: bool = True) -> None:
        self.time_s, self.real, self.late_s = 64.0, real, 0.0

    def now_s(self) -> float:
        return self.time_s

    def wait_until(self, deadline_s: float) -> float:
        self.time_s = max(self.time_s, deadline_s) + self.late_s
        return self.late_s


class Scripted(Transport):
    """A line on which comes what was laid ready: (seconds that it takes, what comes, reports passed over)."""

    def __init__(self, clock: HandClock, *, stream: bool = False, lock_step: bool = False) -> None:
        self.name, self.identity, self.facts = "scripted", "board", {}
        self.stream, self.lock_step, self.can_reopen = stream, lock_step, not lock_step
        self._clock = clock
        self.ready: list[tuple[float, bytes | Exception, int]] = []
        self.waits_s: list[float] = []
        self.sent: list[bytes] = []

    def lay(self, *come: bytes | Exception, takes_s: float = TICK_S, passed_over: int = 0) -> Scripted:
        self.ready += [(takes_s, one, passed_over) for one in come]
        return self

    def open(self) -> None: ...

    def close(self) -> None: ...

    def send(self, report: bytes) -> None:
        self.sent.append(report)

    def receive(self, timeout_s: float) -> bytes:
        self.waits_s.append(timeout_s)
        takes_s, come, passed_over = self.ready.pop(0)
        self._clock.time_s += takes_s
        self.passed_over += passed_over
        if isinstance(come, Exception):
            raise come
        return come


def made(
    profile: TargetProfile = PLAIN, *, real: bool = True, stream: bool = False, lock_step: bool = False
) -> tuple[Line, Any, HandClock]:
    clock = HandClock(real=real)
    board = Scripted(clock, stream=stream, lock_step=lock_step)
    return Line(board, profile, clock), board, clock


# ---- the steps of the board ----------------------------------------------------------------------------------------


def test_each_reading_is_a_step_and_each_report_that_was_passed_over_another() -> None:
    line, board, _ = made()
    assert (line.steps, line.read_s, line.host_was_late, line.steps_are_a_guess) == (0, 64.0, False, False)
    board.lay(GOOD, GOOD).lay(GOOD, passed_over=2).lay(GOOD)
    steps = []
    for _ in range(4):
        assert line.tick() is not None
        steps.append(line.steps)
    assert steps == [1, 2, 5, 6]
    assert line.read_s == 64.0 + 4 * TICK_S
    assert line.statistics.passed_over == 2
    assert set(board.waits_s) == {PLAIN.guards.silence_s}


def test_after_a_tenth_of_a_second_without_a_reading_the_clock_counts_too() -> None:
    for gap_ticks, steps, is_guess in ((12, 2, False), (13, 14, True), (26, 27, True)):  # 94, 102 and 203 ms
        line, board, clock = made()
        board.lay(GOOD, GOOD, GOOD)
        line.tick()
        clock.time_s += (gap_ticks - 1) * TICK_S
        line.tick()
        assert (line.steps, line.steps_are_a_guess) == (steps, is_guess), gap_ticks
        line.tick()
        assert (line.steps, line.steps_are_a_guess) == (steps + 1, False)
    line, board, clock = made()
    clock.time_s = 0.0
    board.lay(GOOD, takes_s=0.0).lay(GOOD, takes_s=0.1)
    line.tick()
    line.tick()
    assert line.steps_are_a_guess is False  # a tenth of a second exactly
    line, board, clock = made()
    board.lay(GOOD).lay(GOOD, passed_over=30)  # more were counted than the clock says
    line.tick()
    clock.time_s += 20 * TICK_S
    line.tick()
    assert line.steps == 32


def test_numbered_reports_say_their_step_themselves() -> None:
    line, board, clock = made(STREAM)
    board.lay(*numbered(7, 8, 12, 13))
    steps = []
    for _ in range(4):
        line.tick()
        clock.time_s += 1.0  # no clock is asked
        steps.append(line.steps)
    assert steps == [1, 2, 6, 7]
    assert line.steps_are_a_guess is False
    line.begin()
    board.lay(*numbered(500))
    assert line.tick() is not None
    assert (line.steps, line.statistics.link.lost) == (8, 3)  # what came while nobody listened is not lost


def test_a_lock_step_board_has_a_step_for_each_tick_whatever_the_clock_says() -> None:
    line, board, clock = made(lock_step=True)
    board.lay(GOOD, TelemetryTimeoutError("none"), GOOD, takes_s=0.0)
    found = []
    for _ in range(3):
        reading = line.tick()
        clock.time_s += 3.0
        found.append((reading is not None, line.steps))
    assert found == [(True, 1), (False, 2), (True, 3)]
    assert line.statistics.silent == 1


# ---- who was late --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("turned_ticks", "waited_ticks", "unread", "was_late", "counted"),
    [
        (1.5, 1.0, 0, False, 0),
        (1.75, 0.25, 0, True, 1),
        (1.75, 0.25, 3, True, 3),
        (0.5, 1.5, 2, False, 0),
        (0.5, 1.75, 2, True, 2),
        (0.5, 1.75, 1, True, 1),
        (0.5, 4.0, 0, False, 0),  # the board was
        (0.5, 0.5, 5, False, 0),  # it sends more often, and is met in time
    ],
)
def test_a_late_computer_is_told_from_a_slow_board(
    turned_ticks: float, waited_ticks: float, unread: int, was_late: bool, counted: int
) -> None:
    line, board, clock = made()
    board.lay(GOOD, passed_over=4).lay(GOOD, takes_s=waited_ticks * TICK_S, passed_over=unread)
    line.tick()
    clock.time_s += turned_ticks * TICK_S
    line.tick()
    assert line.host_was_late is was_late
    assert line.statistics.host_late == counted
    board.lay(GOOD)
    line.tick()
    assert line.host_was_late is False


def test_lateness_is_that_of_the_report_on_a_real_line_and_of_the_clock_in_lock_step() -> None:
    line, board, _ = made()
    board.lay(GOOD, takes_s=3 * TICK_S).lay(BAD, takes_s=4 * TICK_S)
    line.tick()
    assert (line.statistics.ticks, line.statistics.worst_s) == (1, 2 * TICK_S)
    assert line.tick() is None
    assert (line.statistics.ticks, line.statistics.worst_s, line.statistics.refused) == (2, 3 * TICK_S, 1)
    line, board, clock = made(lock_step=True)
    board.lay(GOOD, BAD, takes_s=0.0)
    clock.late_s = 0.25
    line.tick()
    clock.late_s = 0.5
    line.tick()
    assert (line.statistics.worst_s, line.statistics.mean_s) == (0.5, 0.375)
    assert line.host_was_late is False


def test_a_lock_step_board_is_paced_by_absolute_deadlines() -> None:
    line, board, clock = made(lock_step=True)
    board.lay(*[GOOD] * 6, takes_s=0.0)
    times = []
    for late_s in (0.0, 0.5 * TICK_S, 0.0, 1.0, 0.0, 0.0):
        clock.late_s = late_s
        line.tick()
        times.append((clock.time_s - 64.0) / TICK_S)
    assert times == [0.0, 1.5, 2.0, 3.0 + 128.0, 131.0, 131.0]  # a second late is made up for
    line, board, clock = made(lock_step=True)
    board.lay(*[GOOD] * 3, takes_s=0.0)
    clock.late_s = 1.0 + TICK_S
    line.tick()
    clock.late_s = 0.0
    line.tick()
    assert clock.time_s == 64.0 + 1.0 + 2 * TICK_S  # a computer that slept longer begins anew
    clock.time_s += 5.0
    line.begin()
    line.tick()
    assert clock.time_s == 64.0 + 6.0 + 2 * TICK_S


# ---- silence -------------------------------------------------------------------------------------------------------


def test_reports_that_cannot_be_one_are_passed_over_for_as_long_as_silence_may_last() -> None:
    """50 ms are seven ticks of these."""
    line, board, _ = made()
    board.lay(*[BAD] * 6, GOOD, *[BAD] * 7, *[BAD] * 7)
    assert [line.tick() for _ in range(6)] == [None] * 6
    assert line.tick() is not None
    for _ in range(2):  # said once, the count begins anew
        assert [line.tick() for _ in range(6)] == [None] * 6
        with pytest.raises(ReportError, match="63 bytes"):
            line.tick()
    assert (line.statistics.refused, line.statistics.silent) == (20, 0)
    line, board, _ = made(replace(PLAIN, guards=PLAIN.guards.changed({"silence_s": 4 * TICK_S})))
    board.lay(*[BAD] * 4)
    assert [line.tick() for _ in range(3)] == [None] * 3
    with pytest.raises(ReportError):
        line.tick()


def test_silence_on_a_real_line_is_said_at_once_and_in_lock_step_after_its_time() -> None:
    line, board, _ = made()
    board.lay(TelemetryTimeoutError("nothing came"))
    with pytest.raises(TelemetryTimeoutError, match=r"no telemetry for 50 ms: the board stopped sending; .*\(nothing"):
        line.tick()
    line, board, _ = made(lock_step=True)
    board.lay(*[TelemetryTimeoutError("none")] * 7)
    assert [line.tick() for _ in range(6)] == [None] * 6
    with pytest.raises(TelemetryTimeoutError, match="no telemetry for 50 ms"):
        line.tick()


def test_a_stream_of_garbage_ends_with_the_time_that_silence_may_last() -> None:
    line, board, clock = made(STREAM, stream=True)
    board.lay(*[b"garbage"] * 9)
    with pytest.raises(TelemetryTimeoutError, match="no good report for 50 ms"):
        line.tick()
    assert len(board.waits_s) == 7
    assert board.waits_s[:2] == [0.05, pytest.approx(0.05 - TICK_S)]
    board.ready.clear()
    one, two = numbered(1, 2)
    board.lay(one[:5], one[5:] + two, takes_s=0.0)
    reading = line.newest()
    assert (reading.tick, line.statistics.passed_over) == (2, 1)
    board.lay(b"".join(numbered(3, 4, 5)), takes_s=0.0, passed_over=10)
    assert (line.newest().tick, line.statistics.passed_over) == (5, 13)
    exact = replace(STREAM, guards=STREAM.guards.changed({"silence_s": 4 * TICK_S}))
    line, board, clock = made(exact, stream=True)
    board.lay(*[b"garbage"] * 9)
    with pytest.raises(TelemetryTimeoutError):
        line.newest()
    assert len(board.waits_s) == 4
    assert clock.time_s == 64.0 + 4 * TICK_S


def test_a_report_that_is_none_is_raised_where_reports_come_whole() -> None:
    line, board, _ = made()
    board.lay(BAD)
    with pytest.raises(ReportError):
        line.newest()
    assert line.steps == 1


def test_the_guardian_hears_of_each_turn_and_statistics_begin_anew() -> None:
    line, board, _ = made()
    beats: list[int] = []
    line.guardian = SimpleNamespace(beat=lambda: beats.append(1))  # type: ignore[assignment]
    board.lay(GOOD, BAD, GOOD)
    for _ in range(3):
        line.tick()
    assert len(beats) == 3
    before = line.statistics
    line.count_anew()
    assert line.statistics is not before
    assert line.statistics.ticks == 0
    assert line.link.counts is line.statistics.link
    assert line.statistics.real
    line.send(Command.drive(40.0))
    assert board.sent == [PLAIN.codec.encode(Command.drive(40.0))]
