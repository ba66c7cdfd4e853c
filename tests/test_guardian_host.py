"""The host's side of the guardian: how it starts it, beats for it, hears it and lets it go."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from lines import is_open, patient

from fiohost.bench import guardian as host_side
from fiohost.bench import guardian_process as cell
from fiohost.bench.guardian import Guardian
from fiohost.errors import HostError
from fiohost.transport.base import Way

# ---- the host's side -----------------------------------------------------------------------------------------------


class Process:
    """Of a guardian that does what a test says."""

    pid = 4711

    def __init__(self) -> None:
        self.ended: int | None = None
        self.waits: list[float | None] = []
        self.is_slow = False
        self.was_killed = False
        self.far: socket.socket | None = None  # its end of the line to the host
        self.heard = b"nothing"

    def poll(self) -> int | None:
        return self.ended

    def wait(self, timeout_s: float | None = None) -> int:
        self.waits.append(timeout_s)
        if self.far is not None and len(self.waits) == 1:
            self.heard = self.far.recv(10, socket.MSG_DONTWAIT)
        if self.is_slow and not self.was_killed:
            raise subprocess.TimeoutExpired("guardian", timeout_s or 0.0)
        return 0

    def kill(self) -> None:
        self.was_killed = True


class Side:
    """A guardian's host side, with the cells, the far end of the socket and the process in hand."""

    def __init__(self, gap_s: float = 0.1) -> None:
        self.cells = memoryview(bytearray(8 * cell.CELLS)).cast("Q")
        self.cells[cell.STATE], self.cells[cell.REACHES] = cell.READY, 1
        self.process: Any = Process()
        self.word, self.far = socket.socketpair()
        self.process.far = self.far
        self.guardian = Guardian(self.process, self.cells, self.word, gap_s)


@pytest.fixture
def side() -> Iterator[Side]:
    made = Side()
    yield made
    made.word.close()
    made.far.close()


def test_on_duty_it_is_armed_with_a_fresh_beat_and_disarmed_whatever_happens(side: Side) -> None:
    side.cells[cell.BEAT] = 7
    with side.guardian.on_duty():
        assert (side.cells[cell.ARMED], side.cells[cell.BEAT]) == (1, 8)
        side.guardian.beat()
        assert side.cells[cell.BEAT] == 9
    assert side.cells[cell.ARMED] == 0
    with pytest.raises(ZeroDivisionError), side.guardian.on_duty():
        _ = 1 / 0
    assert side.cells[cell.ARMED] == 0


def test_beats_go_on_behind_the_largest_number(side: Side) -> None:
    side.cells[cell.BEAT] = 0xFFFF_FFFE
    side.guardian.beat()
    assert side.cells[cell.BEAT] == 0xFFFF_FFFF
    side.guardian.beat()
    assert side.cells[cell.BEAT] == 0


def test_a_guardian_that_ends_while_it_starts_or_never_starts(side: Side, monkeypatch: pytest.MonkeyPatch) -> None:
    side.cells[cell.STATE] = cell.STARTING
    now_s, slept = [0.0], list[float]()

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now_s[0] += seconds

    monkeypatch.setattr(host_side, "time", SimpleNamespace(monotonic=lambda: now_s[0], sleep=sleep))
    with pytest.raises(HostError, match="could not be started; nothing was driven"), side.guardian.on_duty():
        pass
    assert (min(slept), max(slept)) == (0.002, 0.002)
    assert sum(slept) == pytest.approx(20.0, abs=0.01)
    slept.clear()
    times = iter([0.0, 20.0, 20.25])
    monkeypatch.setattr(host_side, "time", SimpleNamespace(monotonic=lambda: next(times), sleep=slept.append))
    with pytest.raises(HostError, match="could not be started"), side.guardian.on_duty():
        pass
    assert len(slept) == 1  # at its very time it may still come
    monkeypatch.setattr(host_side, "time", SimpleNamespace(monotonic=lambda: 0.0, sleep=slept.append))
    slept.clear()
    side.process.ended = 1
    with pytest.raises(HostError, match="could not be started"), side.guardian.on_duty():
        pass
    assert slept == []
    assert side.cells[cell.ARMED] == 0


def test_it_is_waited_for_until_it_is_ready_and_warned_of_where_it_reaches_nothing(
    side: Side, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    side.cells[cell.STATE] = cell.STARTING
    turns = []

    def sleep(seconds: float) -> None:
        turns.append(seconds)
        if len(turns) == 3:
            side.cells[cell.STATE] = cell.READY

    monkeypatch.setattr(host_side.time, "sleep", sleep)
    with side.guardian.on_duty():
        assert len(turns) == 3
    assert "reaches the board only once" not in caplog.text
    side.cells[cell.REACHES] = 0
    with side.guardian.on_duty():
        pass
    assert "reaches the board only once" in caplog.text


def test_whether_it_had_to_brake(side: Side) -> None:
    assert side.guardian.has_braked is False
    side.cells[cell.STATE] = cell.TRIPPED
    assert side.guardian.has_braked is True


@pytest.mark.parametrize(("gap_s", "deaf_s"), [(0.1, 2.0), (5.0, 5.0)])
def test_it_answers_for_as_long_as_it_was_heard_lately(gap_s: float, deaf_s: float) -> None:
    side = Side(gap_s)
    side.cells[cell.OWN_BEAT] = 1
    assert side.guardian.answers(100.0) is True
    assert side.guardian.answers(100.0 + deaf_s) is True
    assert side.guardian.answers(100.25 + deaf_s) is False
    side.cells[cell.OWN_BEAT] = 2
    assert side.guardian.answers(200.0) is True
    assert side.guardian.answers(200.5) is True
    side.process.ended = -9
    assert side.guardian.answers(200.5) is False
    side.word.close()
    side.far.close()


def test_what_was_heard_before_its_duty_is_forgotten(side: Side, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host_side, "time", SimpleNamespace(monotonic=lambda: 50.0))
    with side.guardian.on_duty():
        assert side.guardian.answers(52.0) is True
        assert side.guardian.answers(52.5) is False


@pytest.mark.parametrize(("braked", "word", "limit_s"), [(True, b"q", 2.0), (False, b"", 20.0)])
def test_it_is_told_how_the_line_was_closed_and_waited_for(
    side: Side, braked: bool, word: bytes, limit_s: float
) -> None:
    side.guardian.close(braked=braked)
    assert side.process.heard == word
    assert side.process.waits == [limit_s]
    assert not side.process.was_killed
    assert side.word.fileno() < 0


def test_one_that_does_not_end_is_ended(side: Side) -> None:
    side.process.is_slow = True
    side.guardian.close()
    assert side.process.was_killed
    assert side.process.waits == [2.0, None]
    assert side.process.heard == b"q"  # as it is where nobody says whether the motor was braked


# ---- starting it ---------------------------------------------------------------------------------------------------


def started(way: Way | None, profile: str, monkeypatch: pytest.MonkeyPatch) -> tuple[Guardian | None, dict[str, Any]]:
    """A guardian of that way, with what its process was started with."""
    asked: dict[str, Any] = {}

    def popen(command: list[str], **options: Any) -> Any:
        asked.update(options, command=command)
        return Process()

    monkeypatch.setattr(host_side.subprocess, "Popen", popen)
    transport: Any = SimpleNamespace(way=way)
    return Guardian.of(transport, patient(profile)), asked


def test_no_motor_no_guardian(monkeypatch: pytest.MonkeyPatch) -> None:
    assert started(None, "serial-framed", monkeypatch) == (None, {})
    monkeypatch.setattr(host_side, "os", SimpleNamespace(name="nt"))
    assert started(Way(fd=5), "serial-framed", monkeypatch) == (None, {})


def test_it_is_started_alone_with_the_line_and_brakes_of_all_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    import json

    guardian, asked = started(Way(fd=5, prefix=b"\0"), "serial-framed", monkeypatch)
    assert guardian is not None
    *command, text = asked["command"]
    assert command == [sys.executable, "-I", "-S", cell.__file__]
    told = json.loads(text)
    assert (told["fd"], told["path"], told["module"], told["prefix"]) == (5, "", "", "00")
    profile = patient("serial-framed")
    assert (told["limit_s"], told["step_s"]) == (profile.guards.gap_s, profile.sample_time_s)
    decoded = [profile.codec.command_layout.decode(bytes.fromhex(frame)) for frame in told["frames"]]
    assert [fields["sequence"] for fields in decoded] == [4096 * k for k in range(16)]
    assert {(fields["duty_pct"], fields["c3"], fields["c4"]) for fields in decoded} == {(0.0, 1, 1)}
    assert asked["start_new_session"] is True
    assert asked["pass_fds"] == [told["memory"], 5]
    assert len(guardian._cells) == cell.CELLS
    assert guardian._deaf_s == profile.guards.gap_s == 20.0
    guardian.close()


def test_layouts_without_numbers_have_one_brake_and_a_module_needs_the_sites_packages(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import json

    guardian, asked = started(Way(path="1-2", module="hid"), "hid-assumed", monkeypatch)
    assert guardian is not None
    assert asked["command"][1:-1] == ["-I", cell.__file__]
    told = json.loads(asked["command"][-1])
    assert len(told["frames"]) == 1
    assert asked["pass_fds"] == [told["memory"]]
    guardian.close()
    guardian, asked = started(Way(fd=0), "hid-assumed", monkeypatch)
    assert guardian is not None
    assert asked["pass_fds"][1:] == [0]
    guardian.close()


def open_fds() -> set[int]:
    return {fd for fd in map(int, os.listdir("/proc/self/fd")) if is_open(fd)}


def test_one_that_cannot_be_started_leaves_nothing_open(monkeypatch: pytest.MonkeyPatch) -> None:
    def popen(*command: Any, **options: Any) -> Any:
        raise OSError(12, "Cannot allocate memory")

    monkeypatch.setattr(host_side.subprocess, "Popen", popen)
    transport: Any = SimpleNamespace(way=Way(fd=5))
    before = open_fds()
    with pytest.raises(HostError, match="cannot start the guardian of the motor: Cannot allocate memory") as caught:
        Guardian.of(transport, patient("serial-documented"))
    assert caught.value.__traceback__ is not None  # what it holds is not closed by chance
    assert open_fds() <= before


def test_a_started_guardian_keeps_its_socket_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    before = open_fds()
    guardian, _ = started(Way(fd=5), "serial-documented", monkeypatch)
    assert guardian is not None
    assert guardian._word.fileno() in open_fds() - before
    assert len(open_fds() - before) <= 2  # and the memory while it is mapped
    guardian.close()
    assert guardian._word.fileno() < 0


def test_memory_is_shared_without_a_name_that_stays(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    for _ in range(2):  # as Linux has it, then as any other system
        fd = host_side._memory()
        assert os.fstat(fd).st_size == 8 * cell.CELLS
        assert list(tmp_path.iterdir()) == []
        os.close(fd)
        monkeypatch.delattr(os, "memfd_create", raising=False)
