"""Boards at the far end of real lines: a pty with a thread behind it, and a hidapi that has what a test says."""

from __future__ import annotations

import os
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Any

from boards import until

from fiohost.bench.clock import Clock
from fiohost.bench.loop import Bench
from fiohost.transport.profile import TargetProfile
from fiohost.transport.serial import SerialTransport
from firmware_model.formats import make_format
from firmware_model.lines.node import PtyLine
from firmware_model.report import Command
from firmware_model.serve import serve

Mangle = Callable[[int, bytes], bytes]
BRAKE = (0, 1, 1)  # compare value, C3, C4
PATIENT = {"gap_s": 20.0, "silence_s": 10.0, "late_pct": 100.0}  # guards of a host on a busy machine
UNDER_WAY = 12  # more packets than ever wait before a board that takes one a step


def patient(profile: str, **guards: float) -> TargetProfile:
    """A shipped profile for a host on a busy machine: it may be held up for long."""
    loaded = TargetProfile.load(profile)
    return replace(loaded, guards=loaded.guards.changed({**PATIENT, **guards}))


class PtyBoard:
    """A board without a motor: its count goes on by 5 a step while it is driven forward. *mangle(k, packet)* is sent,
    and *once_driven(k, packet)* of the k-th step since it was first told to drive.

    ``commands`` are those it has taken, in their order. *runs_away*: whatever it is told, its motor runs.
    """

    def __init__(
        self,
        link: str | None = None,
        *,
        mangle: Mangle = lambda k, p: p,
        once_driven: Mangle = lambda k, p: p,
        step_s: float = 0.005,
        repeats: int = 1,
        layout: str = "documented",
        runs_away: bool = False,
    ) -> None:
        self._form = make_format(layout)
        self.step_s = step_s
        self._mangle, self._once_driven = mangle, once_driven
        self.commands: list[Command] = []
        self.steps = self.pos = self.driven = 0
        self.ended_s = self._stepped_s = 0.0
        self._in_own_time = False  # then it makes up for no step that this computer delayed
        self.runs_away = runs_away
        self.hosts: list[subprocess.Popen[str]] = []  # ended with it: no failed test leaves one behind
        self.line = PtyLine(link)
        self._ended = threading.Event()
        kept = {"step_s": step_s, "repeats": repeats, "stop": self._ended.is_set}
        self._thread = threading.Thread(target=serve, args=(self._step, self.line, layout), kwargs=kept)
        self._thread.start()

    def _step(self, packet: bytes | None) -> bytes:
        command = self._form.parse(packet) if packet is not None else None
        if command is not None:
            self.commands.append(command)
        self.driven += bool(self.driven or (command is not None and command.compare))
        sent = self._mangle(self.steps, self._form.telemetry(0, self.pos))
        if self.driven:
            sent = self._once_driven(self.driven, sent)
        if self.runs_away or (self.commands and self.commands[-1].compare and self.commands[-1].c3):
            self.pos = (self.pos + 5) % 720
        if self._in_own_time:
            time.sleep(max(0.0, self._stepped_s + self.step_s - time.monotonic()))
            self._stepped_s = time.monotonic()
        self.steps += 1
        return sent

    @property
    def target(self) -> str:
        return self.line.where

    def bench(self, silence_s: float = 10.0, **options: Any) -> Bench:
        profile = patient("serial-documented", silence_s=silence_s)
        return Bench(SerialTransport(self.target), profile, clock=self.clock(), **options)

    def clock(self) -> StepClock:
        """Its own time, for a host in this process; from now on it keeps no other."""
        self._in_own_time = True
        return StepClock(self)

    @property
    def braked(self) -> bool:
        return bool(self.commands) and tuple(self.commands[-1]) == BRAKE

    def takes_all(self) -> None:
        """Wait until it has taken what was under way to it, and has been told nothing for some steps."""
        last = -1
        while last != (last := len(self.commands)):
            then = self.steps + UNDER_WAY
            until(lambda: self.steps >= then)  # noqa: B023 (waited for here)

    @property
    def ends_braked(self) -> bool:
        """Once it has taken all that was sent."""
        self.takes_all()
        return self.braked

    def unplug(self) -> None:
        self._end()
        self._thread.join()
        self.line.close()

    def hang_up(self) -> None:
        """Unplug from within a step: the line is gone before the next one."""
        self._end()
        self.line.close()

    def _end(self) -> None:
        self.ended_s = self.ended_s or time.monotonic()
        self._ended.set()

    def __enter__(self) -> PtyBoard:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        for host in self.hosts:
            if host.poll() is None:
                host.kill()
            host.wait()
        self.unplug()


class StepClock(Clock):
    """Time as the board has it: its steps, and once it has gone the computer's. A computer that is slow slows this
    clock too, so that what is held against the board's rate holds on any.
    """

    real = True

    def __init__(self, board: PtyBoard) -> None:
        self._board = board

    def now_s(self) -> float:
        gone_s = time.monotonic() - self._board.ended_s if self._board.ended_s else 0.0
        return self._board.steps * self._board.step_s + gone_s

    def wait_until(self, deadline_s: float) -> float:
        until(lambda: self.now_s() >= deadline_s)
        return self.now_s() - deadline_s


class FakeHidapi:
    """A module like hidapi's: devices in ``infos``, one queue of reports for each path.

    A read with a time takes the next entry of ``script`` first: bytes, None (nothing comes), or an exception.
    """

    __version__ = "0.0-fake"

    def __init__(self, *infos: dict[str, Any]) -> None:
        self.infos = list(infos)
        self.queue: deque[bytes] = deque()
        self.script: deque[bytes | Exception | None] = deque()
        self.written: list[bytes] = []
        self.write_results: deque[int] = deque()
        self.opened = 0
        self.refuses_to_open = False

    def enumerate(self) -> list[dict[str, Any]]:
        return list(self.infos)

    def device(self) -> FakeDevice:
        return FakeDevice(self)


class FakeDevice:
    """A device handle as the one of cython-hidapi behaves."""

    def __init__(self, module: FakeHidapi) -> None:
        self._module = module
        self._blocks = True

    def open_path(self, path: bytes) -> None:
        if self._module.refuses_to_open or path not in [info["path"] for info in self._module.infos]:
            raise OSError("open failed")
        self._module.opened += 1

    def set_nonblocking(self, value: int) -> int:
        self._blocks = not value
        return 0

    def write(self, data: bytes) -> int:
        result = self._module.write_results.popleft() if self._module.write_results else len(data)
        if result >= 0:
            self._module.written.append(bytes(data))
        return result

    def read(self, size: int, timeout_ms: int = 0) -> list[int]:
        module = self._module
        if timeout_ms and module.script:
            entry = module.script.popleft()
            if isinstance(entry, Exception):
                raise entry
            return list(entry or b"")
        if module.queue:
            return list(module.queue.popleft()[:size])
        assert timeout_ms or not self._blocks, "a read without a time would block for ever"
        return []

    def error(self) -> str:
        return "fake error"

    def close(self) -> None:
        pass


def info(path: str = "1-2:1.0", serial: str = "A1", **changes: Any) -> dict[str, Any]:
    """What hidapi says of a device."""
    return {
        "path": path.encode(),
        "vendor_id": 0x0483,
        "product_id": 0x5750,
        "serial_number": serial,
        "product_string": "board",
        "usage_page": 0xFF00,
        "interface_number": 0,
        **changes,
    }


def is_open(fd: int) -> bool:
    try:
        os.fstat(fd)
    except OSError:
        return False
    return True
