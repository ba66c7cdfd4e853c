"""A host that is late is told from a board that is slow, and a run that was not in real time says so."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from lines import patient

from fiohost.bench.clock import Clock
from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.bench.program import Answer
from fiohost.cli.main import cli
from fiohost.errors import HostError, TransportError
from fiohost.transport.base import Transport
from fiohost.wire.messages import Command


class HandClock(Clock):
    """Time passes as the test says."""

    real = True
    time_s = 0.0

    def now_s(self) -> float:
        return self.time_s

    def wait_until(self, deadline_s: float) -> float:
        self.time_s = max(self.time_s, deadline_s)
        return 0.0


class TimedBoard(Transport):
    """A board on a cable that sends a report each *period_s*, but for those left out; a queue keeps the oldest of
    *kept*. At rest, at POS 0.
    """

    can_reopen = True

    def __init__(
        self, clock: HandClock, period_s: float = 0.005, kept: int = 64, sends: Callable[[int], bool] = lambda k: True
    ) -> None:
        self.name, self.identity, self.facts = "timed", "timed", {}
        self._clock, self._period_s, self._kept, self._sends = clock, period_s, kept, sends
        self._next = 1

    def open(self) -> None: ...

    def send(self, report: bytes) -> None: ...

    def close(self) -> None: ...

    def receive(self, timeout_s: float) -> bytes:
        waiting: list[int] = []
        while not waiting:
            due = int(self._clock.time_s / self._period_s + 1e-9)
            waiting = [k for k in range(self._next, due + 1) if self._sends(k)][: self._kept]
            self._next = max(self._next, due + 1)
            if not waiting:
                self._clock.time_s = self._next * self._period_s
        self.passed_over += len(waiting) - 1
        self._clock.time_s += 1e-4
        return bytes(64)


class Slow:
    """A controller that takes 15 ms at every so manieth tick."""

    def __init__(self, clock: HandClock, every: int, ticks: int = 400) -> None:
        self._clock, self._every, self._ticks = clock, every, ticks

    def step(self, k: int, angle_deg: float) -> Answer | None:
        if self._every and k % self._every == 0:
            self._clock.time_s += 0.015
        return (Command.drive(5.0), None) if k < self._ticks else None


def bench_on(clock: HandClock, board: TimedBoard, late_pct: float = 1.0) -> Bench:
    return Bench(board, patient("hid-assumed", late_pct=late_pct), clock=clock)


def test_a_run_that_was_not_in_real_time_is_complete_but_fails(tmp_path: Path) -> None:
    clock = HandClock()
    with bench_on(clock, TimedBoard(clock)) as bench:
        with pytest.raises(HostError, match="missed or answered late because this computer was busy") as caught:
            bench.play(Slow(clock, every=10), tmp_path / "run.csv")
        assert bench.statistics.host_late > 10
    assert any("is closed with its" in note for note in caught.value.__notes__)
    log = Log.read(tmp_path / "run.csv")
    assert log.metadata["ending"] == "complete"
    assert "missed or late because of this computer" in log.metadata["tick_statistics"]


def test_the_limit_is_the_users_and_few_late_ticks_are_no_share(tmp_path: Path) -> None:
    clock = HandClock()
    with bench_on(clock, TimedBoard(clock), late_pct=50.0) as bench:
        bench.play(Slow(clock, every=10))
    with bench_on(clock, TimedBoard(clock)) as bench:
        bench.play(Slow(clock, every=200))


def test_a_gap_of_the_host_ends_the_run() -> None:
    clock = HandClock()
    with Bench(TimedBoard(clock), patient("hid-assumed", gap_s=0.1), clock=clock) as bench:

        class Gap(Slow):
            def step(self, k: int, angle_deg: float) -> Answer | None:
                clock.time_s += 0.11 if k == 50 else 0.0
                return super().step(k, angle_deg)

        with pytest.raises(HostError, match=r"held fiohost up for 0\.11 s"):
            bench.play(Gap(clock, every=0))


def test_a_slow_board_is_not_this_computers_fault() -> None:
    clock = HandClock()
    with bench_on(clock, TimedBoard(clock, sends=lambda k: k % 5 != 0)) as bench:  # every fifth is not sent
        bench.play(Slow(clock, every=0))
        assert bench.statistics.host_late == 0


def test_a_late_host_is_not_taken_for_a_board_of_another_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is held up while the rate is looked at, and the queue loses most of what comes meanwhile."""
    clock = HandClock()
    board = TimedBoard(clock, kept=3)
    receive, calls = board.receive, [0]

    def held(timeout_s: float) -> bytes:
        calls[0] += 1
        clock.time_s += 0.03 if calls[0] % 3 == 0 else 0.0
        return receive(timeout_s)

    monkeypatch.setattr(board, "receive", held)
    with bench_on(clock, board, late_pct=100.0) as bench:
        bench.drive(0.0, 0.1)


@pytest.mark.parametrize("late_s", [0.0, 0.02])
def test_pauses_of_a_line_are_not_taken_for_a_board_of_another_rate(
    late_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What waited in it comes together, behind the first of it. Where the host is late then, the pause alone is seen:
    every 10 ms, for a board that sends every 5 ms.
    """
    clock = HandClock()
    board = TimedBoard(clock, kept=1000)
    receive, calls, pause_s = board.receive, [0], 0.05 if late_s else 0.15

    def paused(timeout_s: float) -> bytes:
        calls[0] += 1
        if calls[0] % 10 == 1:
            clock.time_s += pause_s
            board._next += 1
            return bytes(64)
        clock.time_s += late_s if calls[0] % 10 == 2 else 0.0
        return receive(timeout_s)

    monkeypatch.setattr(board, "receive", paused)
    with bench_on(clock, board, late_pct=100.0) as bench:
        bench.drive(0.0, 0.1)


def test_a_board_of_another_rate_is_still_refused() -> None:
    clock = HandClock()
    for period_s, said in ((0.0136, "every 13.6 ms"), (0.0025, "every 2.5 ms")):
        with bench_on(clock, TimedBoard(clock, period_s)) as bench, pytest.raises(TransportError, match=said):
            bench.drive(0.0, 0.1)


def test_priority_is_had_or_refused_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    run = ["manual", "--pwm", "20", "--duration", "0.05", "--fast", "--realtime-priority"]
    asked: list[int] = []
    if hasattr(os, "sched_setscheduler"):
        monkeypatch.setattr(os, "sched_setscheduler", lambda pid, policy, parameter: asked.append(policy))
        assert CliRunner().invoke(cli, run).exit_code == 0
        assert asked == [os.SCHED_FIFO, os.SCHED_OTHER]

        def refuse(*arguments: object) -> None:
            raise PermissionError(1, "Operation not permitted")

        monkeypatch.setattr(os, "sched_setscheduler", refuse)
    done = CliRunner().invoke(cli, run)
    assert done.exit_code == 1
    assert "--realtime-priority" in done.stderr
