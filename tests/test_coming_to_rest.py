"""How a shaft is brought to rest on a line, and known to stand."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from test_line_ticks import PLAIN, TICK_S, HandClock

from fiohost.bench import rest
from fiohost.bench.clock import Clock
from fiohost.bench.rest import Shaft, brake, braked_after, settle
from fiohost.errors import (
    DisconnectedError,
    MotorRunningError,
    ReportError,
    TelemetryTimeoutError,
    TransportError,
)
from fiohost.transport.profile import TargetProfile
from fiohost.wire.messages import BRAKE_COMMAND, Command

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
