"""The guardian by itself: what it does at each beat, silence and end, step by step; and its host's side of it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
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

STEP_S, LIMIT_S = 0.0078125, 0.125  # 16 steps, exact
FRAMES = [b"\x01", b"\x02", b"\x03"]


class World:
    """Time, cells and the host's socket of one guardian. *script(step)* is asked at each turn; b"" is a dead host."""

    def __init__(self, script: Callable[[int], bytes | None], armed: bool = True) -> None:
        self.cells = memoryview(bytearray(8 * cell.CELLS)).cast("Q")
        self.cells[cell.ARMED], self.cells[cell.STATE] = armed, cell.READY
        self.now_s, self.turn, self.word = 1000.0, 0, b""
        self.sent: list[tuple[int, bytes]] = []
        self.waits_s: list[float] = []
        self._script = script

    def send(self, report: bytes) -> None:
        self.sent.append((self.turn, report))

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        self.waits_s.append(seconds)
        self.turn += 1
        assert self.turn < 10_000, "it goes on for ever"

    def select(self, read: list[int], write: list[int], wrong: list[int], wait_s: float) -> tuple[list[int], ...]:
        self.sleep(wait_s)
        assert (read, write, wrong) == ([0], [], [])
        word = self._script(self.turn)
        self.word = word or b""
        return (read if word is not None else [], [], [])

    def watch(self, monkeypatch: pytest.MonkeyPatch) -> bool:
        clock = SimpleNamespace(monotonic=lambda: self.now_s, sleep=self.sleep)
        monkeypatch.setattr(cell, "time", clock)
        monkeypatch.setattr(cell, "select", SimpleNamespace(select=self.select))
        monkeypatch.setattr(cell.os, "read", lambda fd, size: self.word if (fd, size) == (0, 1) else b"?")
        settings = {"frames": [frame.hex() for frame in FRAMES], "limit_s": LIMIT_S, "step_s": STEP_S}
        line: Any = self
        return cell.watch(line, self.cells, settings)


def beats_until(last: int, world: Callable[[], World], end: int) -> Callable[[int], bytes | None]:
    """A host that beats at each turn up to *last* and says at *end* that it ends."""

    def script(turn: int) -> bytes | None:
        if turn <= last:
            world().cells[cell.BEAT] += 1
        return b"q" if turn == end else None

    return script


def test_while_the_host_beats_nothing_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(beats_until(100, lambda: world, 100))
    assert world.watch(monkeypatch) is False
    assert (world.sent, world.turn, set(world.waits_s)) == ([], 100, {STEP_S})
    assert world.cells[cell.OWN_BEAT] == 99  # one at each turn
    assert (world.cells[cell.STATE], world.cells[cell.TRIPS]) == (cell.READY, 0)


def test_beats_that_stop_are_followed_by_a_brake_a_step_until_the_host_takes_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The last beat is heard at turn 10; the gap is 16 steps long and not exceeded until turn 27."""

    def script(turn: int) -> bytes | None:
        cells = world.cells
        if turn <= 10 or turn == 30:  # beats that come late take nothing back
            cells[cell.BEAT] += 1
        if turn in (26, 27, 40):
            states.append((turn, cells[cell.STATE], len(world.sent)))
        if turn == 40:
            cells[cell.ARMED] = 0
        if turn == 42:
            states.append((turn, cells[cell.STATE], len(world.sent)))
            cells[cell.ARMED] = 1
            cells[cell.BEAT] += 1
        return b"q" if turn == 43 else None

    states: list[tuple[int, int, int]] = []
    world = World(script)
    assert world.watch(monkeypatch) is False
    assert states == [(26, cell.READY, 0), (27, cell.READY, 0), (40, cell.TRIPPED, 13), (42, cell.READY, 13)]
    assert [turn for turn, _ in world.sent] == list(range(27, 40))
    assert [frame for _, frame in world.sent] == [FRAMES[k % 3] for k in range(13)]
    assert world.cells[cell.TRIPS] == 1
    assert set(world.waits_s[:40]) == {STEP_S}
    assert set(world.waits_s[40:42]) == {cell.IDLE_S}


def test_a_host_that_does_not_drive_may_be_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(beats_until(0, lambda: world, 50), armed=False)
    assert world.watch(monkeypatch) is False
    assert (world.sent, set(world.waits_s)) == ([], {0.05})  # so soon it hears that it has to watch


@pytest.mark.parametrize("armed", [True, False])
def test_after_its_hosts_death_it_brakes_for_half_a_second(armed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def script(turn: int) -> bytes | None:
        world.cells[cell.BEAT] += 1
        return b"" if turn == 5 else None

    world = World(script, armed=armed)
    assert world.watch(monkeypatch) is True
    assert [turn for turn, _ in world.sent] == list(range(5, 5 + 64 + 2))  # half a second of steps, and one beyond
    assert [frame for _, frame in world.sent[:4]] == [FRAMES[0], FRAMES[1], FRAMES[2], FRAMES[0]]
    assert set(world.waits_s[5:]) == {STEP_S}


# ---- its line ------------------------------------------------------------------------------------------------------


def line_out(**way: Any) -> cell.LineOut:
    return cell.LineOut({"fd": -1, "path": "", "module": "", "prefix": "", **way})


def test_a_copy_of_the_line_is_written_to_as_it_is() -> None:
    read, write = os.pipe()
    line = line_out(fd=write, prefix="00")
    assert line.open() is True
    line.send(b"abc")
    assert os.read(read, 100) == b"\x00abc"
    line.close()
    assert not is_open(write)
    line.send(b"abc")  # it is closed: nothing is raised
    assert line.open() is True
    os.close(read)


def test_a_descriptor_of_zero_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[object] = []
    monkeypatch.setattr(cell.os, "open", lambda *asked: (done.append("open"), 0)[1])
    monkeypatch.setattr(cell.os, "write", lambda fd, report: done.append((fd, report)))
    monkeypatch.setattr(cell.os, "close", done.append)
    for line in (line_out(fd=0), line_out(path="node")):
        assert line.open() is True
        line.send(b"abc")
        line.close()
    assert done == [(0, b"abc"), 0, "open", (0, b"abc"), 0]


def test_a_node_is_opened_when_it_is_there(tmp_path: Path) -> None:
    node = tmp_path / "node"
    line = line_out(path=str(node))
    assert line.open() is False
    line.send(b"lost")
    node.touch()
    line.send(b"abc")
    line.send(b"def")
    assert node.read_bytes() == b"abcdef"
    line.close()
    assert line.open() is True


def test_a_hidapi_module_is_opened_once_and_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[object] = []
    is_there = [False]

    class Device:
        def open_path(self, path: bytes) -> None:
            if not is_there[0]:
                raise OSError
            done.append(path)

        def write(self, report: bytes) -> int:
            done.append(report)
            return len(report)

        def close(self) -> None:
            done.append("closed")

    monkeypatch.setitem(sys.modules, "fakehid", SimpleNamespace(device=Device))  # type: ignore[arg-type]
    line = line_out(path="1-2:1.0", module="fakehid", prefix="05")
    assert line.open() is False
    is_there[0] = True
    assert line.open() is True
    assert line.open() is True
    line.send(b"abc")
    line.close()
    assert done == [b"1-2:1.0", b"\x05abc", "closed"]


def test_what_it_says_is_said_at_once_or_not_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[tuple[int, bytes]] = []
    for is_read in (True, False):
        ready = [2] if is_read else []
        select = lambda read, write, wrong, wait_s: ([], ready if (write, wait_s) == ([2], 0.0) else [], [])  # noqa: E731, B023
        monkeypatch.setattr(cell, "select", SimpleNamespace(select=select))
        monkeypatch.setattr(cell.os, "write", lambda fd, text: said.append((fd, text)))
        cell._say("words")
    assert said == [(2, b"words")]


def test_a_reader_who_has_stopped_reading_does_not_hold_it() -> None:
    """Whatever standard error is: full, closed or read."""
    read, write = os.pipe()
    code = "import sys, fiohost.bench.guardian_process as cell; cell._say('words\\n')"
    subprocess.run([sys.executable, "-c", code], stderr=write, check=True)
    assert os.read(read, 100) == b"words\n"
    os.set_blocking(write, False)
    while True:
        try:
            os.write(write, bytes(65536))
        except BlockingIOError:
            break
    os.set_blocking(write, True)
    subprocess.run([sys.executable, "-c", code], stderr=write, check=True)
    os.close(read)
    os.close(write)


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


def test_one_that_cannot_be_started_leaves_nothing_open(monkeypatch: pytest.MonkeyPatch) -> None:
    def popen(*command: Any, **options: Any) -> Any:
        raise OSError(12, "Cannot allocate memory")

    monkeypatch.setattr(host_side.subprocess, "Popen", popen)
    transport: Any = SimpleNamespace(way=Way(fd=5))
    before = os.listdir("/proc/self/fd")
    with pytest.raises(HostError, match="cannot start the guardian of the motor: Cannot allocate memory") as caught:
        Guardian.of(transport, patient("serial-documented"))
    caught.value.__traceback__ = caught.value.__cause__.__traceback__ = None  # type: ignore[union-attr]
    assert len(os.listdir("/proc/self/fd")) == len(before)


def test_a_started_guardian_keeps_its_socket_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    before = set(os.listdir("/proc/self/fd"))
    guardian, _ = started(Way(fd=5), "serial-documented", monkeypatch)
    assert guardian is not None
    assert len(set(os.listdir("/proc/self/fd")) - before) <= 2  # the socket, and the memory while it is mapped
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
