"""Driving by statements, statement by statement: what each gives, lets pass, keeps and refuses."""

from __future__ import annotations

import math
import threading
from types import SimpleNamespace
from typing import Any

import pytest
from boards import until

import fiohost
from fiohost.bench import hand
from fiohost.bench.hand import Hand, command_of
from fiohost.errors import ConfigError, DataError, LimitError
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

TICK_S = 0.005


@pytest.fixture
def bench() -> Any:
    with fiohost.connect("sim") as made:
        yield made


def test_time_passes_in_sleep_alone_by_whole_ticks(bench: Any) -> None:
    assert bench.time_s == 0.0
    bench.duty = 40
    _ = bench.angle_deg, bench.speed_deg_s
    bench.sleep(0.0)
    assert bench.time_s == 0.0
    bench.sleep()
    assert bench.time_s == TICK_S
    bench.sleep(3.4 * TICK_S)
    assert bench.time_s == pytest.approx(4 * TICK_S)
    bench.sleep(3.6 * TICK_S)
    assert bench.time_s == pytest.approx(8 * TICK_S)
    bench.sleep(0.1)
    assert bench.time_s == pytest.approx(28 * TICK_S)
    assert len(bench.log) == 28


@pytest.mark.parametrize("seconds", [-1e-9, 86_400.5, math.nan, math.inf])
def test_a_sleep_is_not_negative_and_not_longer_than_a_day(bench: Any, seconds: float) -> None:
    with pytest.raises(ConfigError, match="is not within 0 to 86400 s"):
        bench.sleep(seconds)


def test_a_day_may_be_slept(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.sleep()
    monkeypatch.setattr(Hand, "_wait", lambda self, done: None)
    bench.sleep(86_400.0)
    monkeypatch.undo()


def test_the_log_has_what_was_told_and_seen_at_each_tick(bench: Any) -> None:
    with pytest.raises(DataError, match="nothing was measured yet"):
        _ = bench.log
    told = [(40.0, 1, 0), (-30.0, 0, 1), (0.0, 1, 1), (None, 0, 0)]
    angles = []
    for duty, _, _ in told:
        bench.duty = duty
        bench.sleep()
        angles.append(bench.angle_deg)
    bench.ref_deg = 7
    assert bench.ref_deg == 7.0
    bench.sleep()
    log = bench.log
    for k, (duty, c3, c4) in enumerate(told):
        assert (log.duty_pct[k], log.columns["c3"][k], log.columns["c4"][k]) == (duty or 0.0, c3, c4)
    assert log.time_s.tolist() == pytest.approx([TICK_S * k for k in range(5)])
    assert log.columns["angle_deg"][1:].tolist() == angles
    assert (log.columns["pos"] * 0.5).tolist() == (log.columns["angle_deg"] % 360.0).tolist()
    assert [math.isnan(ref) for ref in log.columns["ref_deg"]] == [True] * 4 + [False]
    assert set(log.columns["direction"]) <= {0.0, 1.0}
    assert (log.metadata["experiment"], log.metadata["target"], str(log.path)) == ("statements", "sim", "(session)")
    assert bench.duty == 0.0


def test_the_speed_is_that_of_the_last_four_ticks(bench: Any) -> None:
    assert bench.speed_deg_s == 0.0  # of one reading
    bench.duty = 60
    bench.sleep()
    angles = [bench.angle_deg]
    for _ in range(60):
        bench.sleep()
        angles.append(bench.angle_deg)
        first = max(0, len(angles) - 5)
        if first:
            wanted = (angles[-1] - angles[first]) / (4 * TICK_S)
            assert bench.speed_deg_s == pytest.approx(wanted)
    assert bench.speed_deg_s > 100.0


def test_a_session_keeps_so_many_rows(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hand, "MOST_ROWS", 7)
    bench.sleep(0.1)
    assert len(bench.log) == 7
    assert bench.time_s == pytest.approx(0.1)


def test_none_is_standby_and_what_cannot_be_sent_is_refused() -> None:
    assert command_of(None) == STANDBY_COMMAND
    assert command_of(12) == Command.drive(12.0)
    with pytest.raises(LimitError):
        command_of(100.5)


def test_a_closed_bench_takes_no_statement_and_closing_twice_is_harmless(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[Any] = []
    monkeypatch.setattr(hand.atexit, "register", kept.append)
    monkeypatch.setattr(hand.atexit, "unregister", lambda one: one in kept and kept.remove(one))
    with fiohost.connect("sim") as made:
        made.sleep(0.1)
        session = made._hand
        assert not session._asleep
        assert kept == [session.close]  # a program that ends without closing brakes too
        thread = session._thread
        assert thread.daemon  # and does not hang where it cannot
    assert kept == []
    assert not thread.is_alive()
    session.close()
    for statement in (
        lambda: session.duty, lambda: session.angle_deg, lambda: session.speed_deg_s, lambda: session.time_s,
        lambda: session.drive(BRAKE_COMMAND), lambda: session.sleep(0.0), lambda: setattr(session, "ref_deg", 1.0),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match="the bench is closed"):
            statement()


def test_what_ends_the_loop_ends_each_statement() -> None:
    with fiohost.connect("sim", limits={"run_time_s": 0.5}) as made:
        made.duty = 20
        session = made._hand
        for statement in (lambda: made.sleep(1.0), lambda: made.duty, lambda: made.angle_deg, lambda: made.sleep()):
            with pytest.raises(LimitError, match="has lasted"):
                statement()
        assert len(session.log({})) == 100  # what was measured is still there


def test_a_loop_that_cannot_begin_says_why_at_the_first_statement() -> None:
    with fiohost.connect("sim") as made:
        made.transport.receive = lambda timeout_s: (_ for _ in ()).throw(OSError("no board"))
        with pytest.raises(OSError, match="no board"):
            made.duty = 10
        del made.transport.receive


class Told:
    """A session whose loop is the test: *paced* or in its own time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, paced: bool) -> None:
        self.now_s = 100.0
        monkeypatch.setattr(hand, "monotonic", lambda: self.now_s)
        session: Any = Hand.__new__(Hand)
        session._tick_s, session._paced = TICK_S, paced
        session._change = threading.Condition()
        session._command, session._ref_deg, session._budget = BRAKE_COMMAND, math.nan, 0
        session._tick, session._began, session._waits, session._ends = 0, False, False, False
        session._angles = hand.deque(maxlen=5)
        session._rows, session._touched_s, session._asleep, session._problem = [], self.now_s, False, None
        self.session = session
        self.told: list[int] = []  # how often those who wait were told
        notify = session._change.notify_all
        session._change.notify_all = lambda: (self.told.append(1), notify())


def test_a_real_motor_is_driven_on_for_two_seconds_after_the_last_statement(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Told(monkeypatch, paced=False)
    session, drive = told.session, Command.drive(40.0)
    session.drive(drive)
    told.now_s = 102.0
    assert session.step(1, 5.0) == (drive, None)
    assert told.told == [1]  # at each tick, so that nobody waits longer than for it
    told.now_s = 102.25
    session._asleep = True
    assert session.step(2, 5.0) == (drive, None)  # a sleep is no absence
    session._asleep = False
    assert session.step(3, 5.0) == (BRAKE_COMMAND, None)
    told.now_s = 110.0
    session.ref_deg = 9.0
    assert session.step(4, 5.0) == (BRAKE_COMMAND, 9.0)  # it is not driven again by itself
    session.drive(drive)
    assert session.step(5, 6.0) == (drive, 9.0)
    assert (session.angle_deg, session.time_s) == (6.0, 5 * TICK_S)
    session._ends = True
    assert session.step(6, 5.0) is None


def test_in_its_own_time_a_sleep_ends_at_its_tick_and_touches_before_and_after(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Told(monkeypatch, paced=False)
    session = told.session
    session.step(10, 5.0)
    done = threading.Event()

    def sleeps() -> None:
        session.sleep(5 * TICK_S)
        done.set()

    sleeper = threading.Thread(target=sleeps)
    sleeper.start()
    until(lambda: session._asleep)
    told.now_s = 150.0
    for k in range(11, 15):
        session.step(k, 5.0)
    assert not done.wait(0.05)
    session.step(15, 5.0)
    sleeper.join()
    assert (session._asleep, session._touched_s, session._budget) == (False, 150.0, 0)


def test_who_waits_is_told_when_the_loop_ends_and_who_closes_waits_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Told(monkeypatch, paced=True)
    session = told.session
    failure = ValueError("it failed")
    played: list[Any] = []

    def live(program: Any, progress: Any, progress_every_s: float) -> None:
        played.append((program, progress_every_s))
        raise failure

    session._drive(SimpleNamespace(live=live))
    assert played == [(session, 0.0)]
    assert (session._problem, session._ends, session._began, told.told) == (failure, True, True, [1])
    joined: list[int] = []
    session._thread = SimpleNamespace(join=lambda: joined.append(1))
    session.close()
    assert (joined, told.told) == ([1], [1, 1])
    session._thread = threading.current_thread()  # the loop itself does not wait for itself
    session.close()
    paced = Told(monkeypatch, paced=True)
    paced.session._budget = 1
    assert paced.session.step(0, 0.0) is not None
    assert (paced.told, paced.session._budget, paced.session._waits) == ([1], 0, False)


def test_a_paced_board_goes_on_by_as_many_ticks_as_are_slept(monkeypatch: pytest.MonkeyPatch) -> None:
    told = Told(monkeypatch, paced=True)
    session = told.session
    stepped: list[int] = []

    def loop() -> None:
        k = 0
        while session.step(k, 0.5 * k) is not None:
            stepped.append(k)
            k += 1

    thread = threading.Thread(target=loop)
    thread.start()
    until(lambda: session._waits)
    assert (stepped, session._began) == ([], True)
    session.sleep(3 * TICK_S)
    until(lambda: len(stepped) == 3)
    assert session.time_s == 3 * TICK_S  # the reading at which it waits
    session.sleep(None)
    until(lambda: len(stepped) == 4)
    told.now_s = 1e6  # nobody takes a duty back there
    session.sleep(None)
    with session._change:
        session._ends = True
        session._change.notify_all()
    thread.join()
    assert stepped == [0, 1, 2, 3, 4]
