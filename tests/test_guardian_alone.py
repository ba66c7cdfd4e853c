"""The guardian by itself: what it does at each beat, silence and end, step by step; and its line."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from lines import is_open

from fiohost.bench import guardian_process as cell

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
