"""Signals, terminals and precedence while a motor is driven: taken, and given back."""

from __future__ import annotations

import io
import os
import signal
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from fiohost.bench import priority, stop, terminal
from fiohost.bench.stop import Stopped, StopSignals
from fiohost.errors import ConfigError, FiohostError


def test_signals_become_a_request_and_are_put_back() -> None:
    before = {name: signal.getsignal(name) for name in (*stop._SIGNALS, signal.SIGTTOU)}
    with StopSignals() as signals:
        assert signal.getsignal(signal.SIGTTOU) == signal.SIG_IGN  # nor does output stop it
        signals.check()
        assert signals.requested == 0
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)  # the first is told
        assert signals.requested == signal.SIGTERM
        with pytest.raises(Stopped, match="stopped by SIGTERM") as caught:
            signals.check()
        assert (caught.value.signum, caught.value.exit_code) == (15, 143)
    assert {name: signal.getsignal(name) for name in before} == before
    assert str(Stopped(99)) == "stopped by 99"


def test_a_second_signal_is_raised_at_once_where_the_loop_may_hang_and_only_there() -> None:
    with StopSignals() as signals:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        with signals.interruptible(), pytest.raises(Stopped, match="Ctrl-C"):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        with signals.interruptible():
            pass
        signal.raise_signal(signal.SIGTERM)
    with StopSignals() as signals, signals.interruptible():
        signal.raise_signal(signal.SIGINT)  # the first is never raised
        assert signals.requested == signal.SIGINT
        with pytest.raises(Stopped):
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)  # while it is on its way out no more


def test_what_was_ignored_stays_ignored_and_a_thread_changes_nothing() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopSignals() as signals:
            signal.raise_signal(signal.SIGHUP)
            assert signals.requested == 0
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    seen: list[object] = []

    def run() -> None:
        with StopSignals():
            seen.append(signal.getsignal(signal.SIGTERM) == handler)

    handler = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [True]


def test_what_fails_for_want_of_the_terminal_is_its_hang_up() -> None:
    def ended(requested: int, failure: BaseException) -> BaseException:
        signals = StopSignals()
        signals.requested = requested
        failure.add_note("a note")
        try:
            with signals.hang_ups():
                raise failure
        except BaseException as exc:
            return exc

    for failure in (OSError("no terminal"), FiohostError("no log")):
        found = ended(signal.SIGHUP, failure)
        assert isinstance(found, Stopped)
        assert (found.exit_code, found.__notes__, found.__cause__) == (129, ["a note"], failure)
        assert ended(0, failure) is failure
        assert ended(signal.SIGTERM, failure) is failure
    other = ValueError()
    assert ended(signal.SIGHUP, other) is other


def test_a_terminals_flow_control_is_off_meanwhile_and_as_before_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    import termios

    far, near = os.openpty()
    mode = termios.tcgetattr(near)
    mode[0] |= termios.IXON
    termios.tcsetattr(near, termios.TCSANOW, mode)

    def has_flow_control() -> bool:
        return bool(termios.tcgetattr(near)[0] & termios.IXON)

    stream: Any = SimpleNamespace(fileno=lambda: near)
    for name in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(terminal.sys, name, stream)
    group = [os.getpgrp()]
    monkeypatch.setattr(terminal.os, "tcgetpgrp", lambda fd: group[0])
    before = {number: signal.getsignal(number) for number in (signal.SIGTTOU, signal.SIGTTIN)}
    with terminal.not_held_up():
        assert not has_flow_control()
        assert {signal.getsignal(number) for number in before} == {signal.SIG_IGN}
    assert has_flow_control()
    assert {number: signal.getsignal(number) for number in before} == before
    group[0] += 1
    with terminal.not_held_up():  # a background job leaves the terminal alone
        assert has_flow_control()
    group[0] -= 1
    mode[0] &= ~termios.IXON
    termios.tcsetattr(near, termios.TCSANOW, mode)
    with terminal.not_held_up():
        assert not has_flow_control()
    assert not has_flow_control()
    for stream in (io.StringIO(), None, SimpleNamespace(fileno=lambda: far + 500)):
        monkeypatch.setattr(terminal.sys, "stdin", stream)
        with terminal.not_held_up():
            pass
    os.close(far)
    os.close(near)


def test_precedence_is_taken_and_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    set_: list[tuple[int, int, int]] = []
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: 40 + pid)
    monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(3 + pid))
    monkeypatch.setattr(os, "sched_setscheduler", lambda pid, how, param: set_.append((pid, how, param.sched_priority)))
    with pytest.raises(KeyError), priority.realtime_priority():
        raise KeyError
    assert set_ == [(0, os.SCHED_FIFO, 10), (0, 40, 3)]

    def forbidden(pid: int, how: int, param: object) -> None:
        raise PermissionError(1, "not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", forbidden)
    with pytest.raises(ConfigError, match=r"not allowed here \(not permitted\)"), priority.realtime_priority():
        pass
    monkeypatch.delattr(os, "sched_setscheduler")
    with pytest.raises(ConfigError, match="only Linux has"), priority.realtime_priority():
        pass
