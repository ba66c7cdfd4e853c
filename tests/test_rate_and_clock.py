"""Before it drives, a bench on a real line brakes, hears a first word and judges the board's rate; and its clocks."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from fiohost.bench import clock as clocks
from fiohost.bench.cable import Rate, brake_when_back, greet
from fiohost.bench.clock import MonotonicClock, PlayedClock, VirtualClock
from fiohost.errors import MotorRunningError, TelemetryTimeoutError, TransportError
from fiohost.transport.profile import TargetProfile

BRAKE = b"brake"
TICK_S = 2.0**-7  # sums of it are exact
PROFILE = replace(TargetProfile.load("serial-documented"), sample_time_s=TICK_S)


class Board:
    """A board that says its first word at *speaks_s* of the clock; a line to it that keeps what it was told."""

    def __init__(self, clock: VirtualClock, speaks_s: float, *, can_reopen: bool = True) -> None:
        self.name, self.can_reopen = "board", can_reopen
        self.told: list[bytes | str] = []
        self.waits_s: list[float] = []
        self._clock, self._speaks_s = clock, speaks_s

    def send(self, report: bytes) -> None:
        self.told.append(report)

    def receive(self, timeout_s: float) -> bytes:
        self.waits_s.append(timeout_s)
        self._clock.wait_until(self._clock.now_s() + timeout_s)
        if self._clock.now_s() < self._speaks_s:
            raise TelemetryTimeoutError("nothing came")
        return b"word"

    def close(self) -> None:
        self.told.append("closed")


def greeted(speaks_s: float, profile: TargetProfile = PROFILE, **options: Any) -> Board:
    clock = VirtualClock()
    clock.wait_until(10.0)
    board: Any = Board(clock, 10.0 + speaks_s, **options)
    try:
        greet(board, BRAKE, clock, profile)
    except TelemetryTimeoutError as exc:
        board.told.append(str(exc))
    return board


def test_a_board_is_braked_first_of_all_and_heard_at_its_first_word() -> None:
    for speaks_s, listens in ((0.0, 1), (0.5, 10), (1.9, 38)):
        board = greeted(speaks_s)
        assert board.told == [BRAKE]
        assert len(board.waits_s) == pytest.approx(listens, abs=1)
        assert set(board.waits_s) == {0.05}


def test_a_board_that_says_nothing_for_two_seconds_is_let_go() -> None:
    board = greeted(1e9)
    assert board.told[:2] == [BRAKE, "closed"]
    assert "open but sends nothing for 2 s" in str(board.told[2])
    assert sum(board.waits_s) == pytest.approx(2.0, abs=0.11)
    patient = greeted(1e9, replace(PROFILE, guards=PROFILE.guards.changed({"silence_s": 7.0})))
    assert "sends nothing for 7 s" in str(patient.told[2])
    assert sum(patient.waits_s) == pytest.approx(7.0, abs=0.11)


def test_a_board_is_heard_once_more_when_its_time_has_just_passed() -> None:
    clock = VirtualClock()
    board: Any = Board(clock, 1e9)
    listen, heard = board.receive, []

    def receive(timeout_s: float) -> bytes:
        heard.append(clock.now_s())
        return listen(0.5)

    board.receive = receive
    with pytest.raises(TelemetryTimeoutError):
        greet(board, BRAKE, clock, PROFILE)
    assert heard == [0.0, 0.5, 1.0, 1.5, 2.0]


def test_a_board_whose_brake_cannot_be_sent_is_let_go() -> None:
    board: Any = Board(VirtualClock(), 0.0)
    send = board.send

    def fails(report: bytes) -> None:
        send(report)
        raise TransportError("no way")

    board.send = fails
    with pytest.raises(TransportError, match="no way"):
        greet(board, BRAKE, VirtualClock(), PROFILE)
    assert board.told == [BRAKE, "closed"]


@pytest.mark.parametrize(
    ("watchdog_s", "can_reopen", "is_said"), [(0.0, True, True), (0.5, True, False), (0.0, False, False)]
)
def test_a_board_on_a_cable_without_a_watchdog_is_warned_of(
    watchdog_s: float, can_reopen: bool, is_said: bool, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, "fiohost.bench"):
        greeted(0.0, replace(PROFILE, watchdog_s=watchdog_s), can_reopen=can_reopen)
    assert ("has no watchdog" in caplog.text) == is_said


# ---- the rate ------------------------------------------------------------------------------------------------------


def rate(step_s: float, steps: int, late: int = 0, begin_s: float = 1.0) -> Rate:
    """After so many steps of the board, and so many readings that came late to this computer."""
    made = Rate("board", PROFILE)
    for k in range(late):
        made.note(0.1 * k, k, host_was_late=True)
    for k in range(steps + 1):
        made.note(begin_s + step_s * k, 50 + k)
    return made


def test_a_rate_within_a_quarter_of_the_profiles_is_right() -> None:
    for factor, right in ((1.0, True), (1.25, True), (0.75, True), (1.25 + 2**-20, False), (0.75 - 2**-20, False)):
        assert rate(factor * TICK_S, 99).is_right() is right, factor


def test_a_wrong_rate_is_sure_after_a_hundred_steps_and_said_with_its_number() -> None:
    assert rate(2.0 * TICK_S, 99).is_right() is False
    with pytest.raises(TransportError, match=r"board sends a report every 15\.6 ms, the profile .* says 7\.8125 ms"):
        rate(2.0 * TICK_S, 100).is_right()
    with pytest.raises(TransportError, match=r"every 3\.91 ms.*set sample_time_s = 0\.0039"):
        rate(0.5 * TICK_S, 400).is_right()


def test_a_computer_that_is_late_too_often_cannot_tell() -> None:
    with pytest.raises(TransportError):
        rate(2.0 * TICK_S, 100, late=5).is_right()
    assert rate(2.0 * TICK_S, 100, late=6).is_right() is False


def test_where_nothing_was_noted_the_rate_is_right_and_one_reading_says_nothing_yet() -> None:
    made = Rate("board", PROFILE)
    assert made.is_right() is True
    made.note(1.0, 50)
    assert made.is_right() is False
    made.note(9.0, 51, host_was_late=True)
    assert made.is_right() is True


@pytest.mark.parametrize("doubt", ["host_was_late", "is_guess"])
def test_neither_interval_beside_a_doubtful_reading_counts(doubt: str) -> None:
    made = Rate("board", PROFILE)
    for k in range(40):
        is_doubtful = k % 10 == 5
        shift_s = 0.9 * TICK_S if is_doubtful else 0.0
        made.note(1.0 + TICK_S * k + shift_s, k + 3 * is_doubtful, **({doubt: True} if is_doubtful else {}))
    assert made.is_right() is True
    assert made._steps == 31  # of 39 intervals, without the eight beside the four
    assert made._seconds == 31 * TICK_S


def test_a_board_that_makes_up_for_a_pause_of_this_computer_is_no_faster_board() -> None:
    made, time_s = Rate("board", PROFILE), 1.0
    for k in range(400):
        since = (k + 31) % 40  # a pause of 16 steps, made up for by the next 30, each at half its time
        time_s += TICK_S * (16.0 if since == 0 else 0.5 if since <= 30 else 1.0)
        made.note(time_s, k, host_was_late=since == 0)
    assert made.is_right() is True
    assert made._seconds == made._steps * TICK_S


# ---- a board that comes back ---------------------------------------------------------------------------------------


def came_back(reopen: Callable[[], None], brake: Callable[[], None], known: bool = True, limit_s: float = 2.0) -> str:
    clock = VirtualClock()
    clock.wait_until(100.0)
    line: Any = SimpleNamespace(can_reopen=True, is_known_again=known, reopen=reopen)
    return brake_when_back(line, brake, OSError("gone"), clock, limit_s, lambda: False)


def test_what_came_of_a_board_that_went_away_is_said() -> None:
    done: list[str] = []
    back = came_back(lambda: done.append("open"), lambda: done.append("brake"))
    assert done == ["open", "brake"]
    assert back == "the board came back after 0.0 s and was braked first of all: its shaft stands"
    other = came_back(lambda: None, lambda: None, known=False)
    assert other.startswith("a board came back after 0.0 s and was braked first of all: its shaft stands; it has no ")

    def runs() -> None:
        raise MotorRunningError("the shaft still turns")

    assert came_back(lambda: None, runs) == "a board came back after 0.0 s, but the shaft still turns"


def test_a_board_is_waited_for_as_long_as_was_asked_and_no_longer() -> None:
    clock = SimpleNamespace(time_s=100.0, now_s=lambda: clock.time_s, wait_until=lambda deadline_s: None)
    tried: list[float] = []

    def reopen() -> None:
        tried.append(clock.time_s)
        clock.time_s += 0.5
        raise OSError

    line: Any = SimpleNamespace(can_reopen=True, is_known_again=True, reopen=reopen)
    said = brake_when_back(line, lambda: None, OSError("gone"), clock, 2.0, lambda: False)  # type: ignore[arg-type]
    assert tried == [100.0, 100.5, 101.0, 101.5]
    assert said.startswith("the brake could not be sent (gone): THE MOTOR MAY BE RUNNING")
    assert said.endswith("; it was not back after 2.0 s")
    line.can_reopen = False
    said = brake_when_back(line, lambda: None, OSError("gone"), clock, 2.0, lambda: False)  # type: ignore[arg-type]
    assert said.endswith("MAY BE RUNNING; cut its power, or plug the board in and run 'fiohost manual --pwm 0'")


# ---- clocks --------------------------------------------------------------------------------------------------------


def test_virtual_time_begins_at_nothing_passes_where_somebody_waits_and_never_goes_back() -> None:
    clock = VirtualClock()
    assert (clock.real, clock.now_s()) == (False, 0.0)
    assert (clock.wait_until(0.5), clock.now_s()) == (0.0, 0.5)
    assert (clock.wait_until(0.25), clock.now_s()) == (0.0, 0.5)


def test_real_time_is_slept_to_the_deadline_and_lateness_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    now, slept = [10.0], list[float]()

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += seconds + 0.125  # the system wakes a little later

    monkeypatch.setattr(clocks, "time", SimpleNamespace(monotonic=lambda: now[0], sleep=sleep))
    clock = MonotonicClock()
    assert clock.real
    assert (clock.wait_until(10.5), slept) == (0.125, [0.5])
    assert (clock.wait_until(10.625), slept) == (0.0, [0.5])  # it has come: nothing to sleep for
    assert (clock.wait_until(10.0), slept) == (0.625, [0.5])
    monkeypatch.setattr(clocks.time, "sleep", lambda seconds: None)  # one that wakes too early
    assert clock.wait_until(11.0) == 0.0


def test_a_recorded_clock_is_as_late_as_it_was() -> None:
    clock = PlayedClock(lambda: 3.0)
    assert clock.real
    assert (clock.now_s(), clock.wait_until(2.5), clock.wait_until(3.5)) == (3.0, 0.5, 0.0)
