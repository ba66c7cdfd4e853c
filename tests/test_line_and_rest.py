"""The line tick by tick, with a clock and a board that do what a test says; how a shaft is brought to rest on it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from test_framing import numbered

from fiohost.bench import rest
from fiohost.bench.clock import Clock
from fiohost.bench.line import Line
from fiohost.bench.rest import Shaft, brake, braked_after, settle
from fiohost.errors import (
    DisconnectedError,
    MotorRunningError,
    ReportError,
    TelemetryTimeoutError,
    TransportError,
)
from fiohost.transport.base import Transport
from fiohost.transport.profile import TargetProfile
from fiohost.wire.messages import BRAKE_COMMAND, Command

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


# ---- the shaft's motion --------------------------------------------------------------------------------------------


def shaft(profile: TargetProfile = PLAIN) -> Shaft:
    line: Any = SimpleNamespace(profile=profile)
    return Shaft(line)


def test_a_shaft_stands_when_a_tenth_of_a_second_of_readings_says_so() -> None:
    """13 steps of 7.8125 ms and the reading before them."""
    found = shaft()
    for k in range(14):
        assert (found.is_known, found.stands) == (False, False)
        found.note(k, 5 + k % 2)
    assert (found.is_known, found.stands) == (True, True)
    found.note(14, 7)
    assert (found.is_known, found.stands) == (True, False)
    slow = shaft(replace(PLAIN, sample_time_s=1.0))
    slow.note(0, 5)
    assert not slow.stands
    slow.note(1, 5)
    assert slow.stands


def test_the_speed_of_a_shaft_is_that_over_its_last_readings() -> None:
    found = shaft()
    assert found.speed_deg_s == 0.0
    found.note(10, 719)
    assert found.speed_deg_s == 0.0
    found.note(12, 1)  # two counts of half a degree in two steps
    assert found.speed_deg_s == 64.0
    found.note(12, 3)
    assert found.speed_deg_s == 128.0
    again = shaft()
    again.note(7, 4)
    again.note(7, 2)  # the step is not known better
    assert again.speed_deg_s == -128.0
    for k in range(20, 40):
        again.note(k, (3 * k) % 720)
    assert again.speed_deg_s == 192.0


# ---- bringing it to rest -------------------------------------------------------------------------------------------


class StubLine:
    """A line as these functions see it: *pos(k)* is the reading of its k-th tick, None where none comes."""

    def __init__(self, pos: Callable[[int], Any], *, lock_step: bool = False, real: bool = True) -> None:
        self.clock = HandClock(real=real)
        self.transport: Any = SimpleNamespace(lock_step=lock_step, can_reopen=not lock_step, name="stub")
        self.profile = PLAIN
        self.guardian: Any = None
        self.host_was_late = self.steps_are_a_guess = False
        self.steps, self.read_s, self.ticks = 0, 64.0, 0
        self.sent: list[tuple[int, Command]] = []
        self.done: list[str] = []
        self._pos = pos

    @property
    def statistics(self) -> Any:
        return SimpleNamespace(ticks=self.ticks)

    def begin(self) -> None:
        self.done.append("begin")

    def count_anew(self) -> None:
        self.done.append("anew")

    def send(self, command: Command) -> None:
        self.sent.append((self.ticks, command))

    def tick(self) -> Any:
        self.ticks += 1
        self.steps += 1
        self.clock.time_s += TICK_S
        self.read_s = self.clock.time_s
        pos = self._pos(self.ticks)
        if isinstance(pos, Exception):
            raise pos
        return None if pos is None else SimpleNamespace(pos=pos)

    def newest(self) -> Any:
        found = self.tick()
        if found is None:
            raise TelemetryTimeoutError("none")
        return found


class Stop:
    requested = 0
    checks = 0

    def check(self) -> None:
        self.checks += 1


def settled(line: StubLine) -> tuple[bool, int]:
    stop: Any = Stop()
    found = settle(line, stop)  # type: ignore[arg-type]
    assert stop.checks == line.ticks
    assert line.done == ["begin", "anew", "anew"]
    assert {command for _, command in line.sent} <= {BRAKE_COMMAND}
    return found, line.ticks


def test_a_shaft_at_rest_has_no_count_for_a_tenth_of_a_second() -> None:
    """13 equal readings behind a first one; on a real line three ticks pass before it is sent anything."""
    line = StubLine(lambda k: 7)
    assert settled(line) == (True, 14)
    assert [tick for tick, _ in line.sent] == list(range(4, 15))
    line = StubLine(lambda k: 7, lock_step=True)
    assert settled(line) == (True, 14)
    assert [tick for tick, _ in line.sent] == list(range(1, 15))
    assert settled(StubLine(lambda k: min(k, 10))) == (True, 23)
    assert settled(StubLine(lambda k: None if k % 2 else 7)) == (True, 28)
    assert settled(StubLine(lambda k: 7 if k != 12 else 8)) == (True, 26)


def test_a_board_that_does_not_brake_is_not_driven() -> None:
    line = StubLine(lambda k: 3 * k % 720)
    stop: Any = Stop()
    with pytest.raises(MotorRunningError, match=r"sent for 5 s before the run, and the shaft still turns at 192 deg/s"):
        settle(line, stop)  # type: ignore[arg-type]
    assert line.ticks == 640  # 5 s
    assert settled(StubLine(lambda k: 3 * k % 720, lock_step=True)) == (False, 640)


def test_a_load_may_turn_a_braked_shaft_slowly(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "fiohost.bench"):
        assert settled(StubLine(lambda k: (k * 6 // 7) % 720)) == (False, 640)  # 54 deg/s
        assert "still moving under brake after 5.000 s at POS 548" in caplog.text
        settled(StubLine(lambda k: 7))
        assert "at rest after 0.109 s at POS 7" in caplog.text


def test_the_rate_is_looked_at_on_a_real_line_until_it_is_sure() -> None:
    class Doubled(StubLine):
        def tick(self) -> Any:
            found = super().tick()
            self.clock.time_s += TICK_S
            self.read_s = self.clock.time_s
            return found

    stop: Any = Stop()
    line = Doubled(lambda k: 7)
    with pytest.raises(TransportError, match=r"stub sends a report every 15\.6 ms"):
        settle(line, stop)  # type: ignore[arg-type]
    assert line.ticks == 104  # three, and a hundred steps between the readings behind them
    for lock_step, real in ((True, True), (False, False)):
        assert settled(Doubled(lambda k: 7, lock_step=lock_step, real=real)) == (True, 14)
    late = Doubled(lambda k: 7)
    late.host_was_late = True
    assert settled(late) == (True, 14)  # this computer cannot tell
    guess = Doubled(lambda k: 7)
    guess.steps_are_a_guess = True
    assert settled(guess) == (True, 14)


# ---- braking -------------------------------------------------------------------------------------------------------


def braked(line: StubLine) -> int:
    brake(line)  # type: ignore[arg-type]
    assert {command for _, command in line.sent} == {BRAKE_COMMAND}
    return line.ticks


def test_on_a_real_line_the_brake_goes_out_once_a_reading_until_the_shaft_stands() -> None:
    line = StubLine(lambda k: 7)
    assert braked(line) == 14
    assert [tick for tick, _ in line.sent] == list(range(14))
    assert braked(StubLine(lambda k: 3 * min(k, 20))) == 34 - 1
    assert braked(StubLine(lambda k: None if k < 60 else 7)) == 60 + 13


def test_a_shaft_that_does_not_come_to_rest_or_says_nothing_is_said_to_run() -> None:
    line = StubLine(lambda k: 3 * k % 720)
    with pytest.raises(MotorRunningError, match="was sent, but the shaft still turns at 192 deg/s: THE MOTOR"):
        brake(line)  # type: ignore[arg-type]
    assert line.ticks == 256  # 2 s
    line = StubLine(lambda k: None)
    with pytest.raises(MotorRunningError, match="but no reading says that the shaft stands: THE MOTOR MAY BE RUNNING"):
        brake(line)  # type: ignore[arg-type]
    assert line.ticks == 65  # beyond half a second
    trace = StubLine(lambda k: None)
    trace.transport.can_reopen = False
    assert braked(trace) == 65


def test_a_load_may_turn_it_on_with_a_warning(caplog: pytest.LogCaptureFixture) -> None:
    for sign in (1, -1):
        caplog.clear()
        assert braked(StubLine(lambda k: (sign * k * 6 // 7) % 720)) == 256  # noqa: B023
        assert f"braked, and the shaft still turns at {sign * 54} deg/s: a load does that" in caplog.text
    exact = StubLine(lambda k: k)
    exact.profile = replace(PLAIN, guards=PLAIN.guards.changed({"braked_deg_s": 64.0}))
    assert braked(exact) == 256
    slow = StubLine(lambda k: (k * 6 // 7) % 720)
    slow.profile = replace(PLAIN, guards=PLAIN.guards.changed({"braked_deg_s": 40.0}))
    with pytest.raises(MotorRunningError):
        brake(slow)  # type: ignore[arg-type]


def test_a_simulated_board_is_seen_to_stand_while_it_is_told_and_while_it_is_not() -> None:
    line = StubLine(lambda k: 7, lock_step=True)
    assert braked(line) == 10
    assert [tick for tick, _ in line.sent] == list(range(5))
    assert braked(StubLine(lambda k: max(7, 12 - k), lock_step=True)) == 15
    assert braked(StubLine(lambda k: k, lock_step=True)) == 13 * 5  # a second, half of it for listening
    assert braked(StubLine(lambda k: None, lock_step=True)) == 13 * 5


def test_whatever_is_the_matter_with_reading_a_brake_goes_out_each_step(caplog: pytest.LogCaptureFixture) -> None:
    def broken(k: int) -> Any:
        return ValueError("odd") if k < 10 else 7

    line = StubLine(broken)
    with caplog.at_level(logging.INFO, "fiohost.bench"):
        assert braked(line) == 9 + 14
    assert line.clock.time_s == 64.0 + (9 + 14 + 9) * TICK_S  # a step is waited for where none came
    assert "braking without readings: ValueError: odd" in caplog.text
    refused = StubLine(lambda k: ReportError("no", "length") if k < 10 else 7)
    assert braked(refused) == 9 + 14
    assert refused.clock.time_s == 64.0 + 23 * TICK_S
    gone = StubLine(lambda k: DisconnectedError("gone"))
    with pytest.raises(DisconnectedError):
        brake(gone)  # type: ignore[arg-type]
    assert gone.ticks == 1


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the brake comes to, and what was done."""
    found: dict[str, Any] = {"fails": None, "done": [], "asked": []}

    def fake(line: Any) -> None:
        found["done"].append("brake")
        if found["fails"] is not None:
            raise found["fails"]

    def back(line: Any, again: Any, failed: Exception, clock: Clock, limit_s: float, is_stopped: Any) -> str:
        found["asked"].append((str(failed), limit_s, is_stopped()))
        return "what came of it"

    monkeypatch.setattr(rest, "brake", fake)
    monkeypatch.setattr(rest.cable, "brake_when_back", back)
    return found


def run(line: StubLine, failure: BaseException | None) -> BaseException | None:
    stop: Any = Stop()
    try:
        with braked_after(line, stop, 4.0):  # type: ignore[arg-type]
            if failure is not None:
                raise failure
    except BaseException as exc:
        return exc
    return None


def test_a_run_ends_with_one_brake_however_it_ends(ends: dict[str, Any]) -> None:
    line = StubLine(lambda k: 7)
    assert run(line, None) is None
    assert ends["done"] == ["brake"]
    failure = KeyboardInterrupt()
    assert run(line, failure) is failure
    assert ends["done"] == ["brake"] * 2
    assert not getattr(failure, "__notes__", [])
    ends["fails"] = MotorRunningError("it runs")
    assert run(line, None) is ends["fails"]
    failed = ValueError("first")
    assert run(line, failed) is failed
    assert failed.__notes__ == ["it runs"]
    assert ends["asked"] == []


def test_a_brake_that_could_not_be_sent_is_left_to_the_guardian_and_to_the_board_that_comes_back(
    ends: dict[str, Any],
) -> None:
    line = StubLine(lambda k: 7)
    closed: list[bool] = []
    line.guardian = SimpleNamespace(close=lambda braked: closed.append(braked))
    ends["fails"] = DisconnectedError("gone")
    failed = ValueError("first")
    assert run(line, failed) is failed
    assert failed.__notes__ == ["what came of it"]
    assert (closed, line.guardian, ends["asked"]) == ([False], None, [("gone", 4.0, False)])
    assert run(line, ValueError("again")) is not None
    assert closed == [False]
