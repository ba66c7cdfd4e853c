"""The host's side of the guardian: starts it, beats for it, hears whether it had to brake.

The guardian (:mod:`fiohost.bench.guardian_process`) brakes a real board ``guards.gap_s`` (0.1 s) after the last beat.
So the motor is braked whatever becomes of this process: killed, stopped, crashed, or caught in a controller that hangs.
"""

from __future__ import annotations

import json
import logging
import mmap
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fiohost.bench import guardian_process as cell
from fiohost.errors import HostError
from fiohost.transport.base import Transport
from fiohost.transport.profile import TargetProfile
from fiohost.wire.messages import BRAKE_COMMAND

logger = logging.getLogger("fiohost.bench")

DEAF_LIMIT_S = 2.0  # without a sign of life of the guardian itself; longer where guards.gap_s is
START_LIMIT_S = 20.0
END_LIMIT_S = 2.0
LAST_LIMIT_S = 20.0  # for its own brake, where nobody else could
FRAMES = 16  # of a layout that numbers its commands: spread over all numbers


class Guardian:
    """One guardian for one open line. A context of its use: :meth:`on_duty`."""

    def __init__(self, process: subprocess.Popen[bytes], cells: memoryview, word: socket.socket, gap_s: float) -> None:
        self._process, self._cells, self._word = process, cells, word
        self._deaf_s = max(DEAF_LIMIT_S, gap_s)  # who lets the host stand still for so long lets its guardian too
        self._own_beat, self._heard_s = 0, time.monotonic()

    @classmethod
    def of(cls, transport: Transport, profile: TargetProfile) -> Guardian | None:
        """The guardian of an open line; None where the medium has none, or this system cannot. Raises HostError."""
        way = transport.way
        if way is None or os.name != "posix":
            return None
        ours, theirs = socket.socketpair()
        memory = _memory()
        step = -(-profile.codec.command_numbers // FRAMES)
        frames = [profile.codec.encode(BRAKE_COMMAND, n) for n in range(0, profile.codec.command_numbers, step)]
        settings = {
            "memory": memory,
            "fd": way.fd,
            "path": way.path,
            "module": way.module,
            "prefix": way.prefix.hex(),
            "frames": [frame.hex() for frame in frames],
            "limit_s": profile.guards.gap_s,
            "step_s": profile.sample_time_s,
        }
        lean = [] if way.module else ["-S"]  # a hidapi module is among the site's packages
        command = [sys.executable, "-I", *lean, str(Path(cell.__file__)), json.dumps(settings)]
        try:
            process = subprocess.Popen(
                command,
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                pass_fds=[fd for fd in (memory, way.fd) if fd >= 0],
                start_new_session=True,  # what is typed into the terminal is not for it
            )
            cells = memoryview(mmap.mmap(memory, 8 * cell.CELLS)).cast("Q")
        except OSError as exc:
            ours.close()
            raise HostError(f"cannot start the guardian of the motor: {exc.strerror}; nothing was driven") from exc
        finally:
            theirs.close()
            os.close(memory)
        return cls(process, cells, ours, profile.guards.gap_s)

    @contextmanager
    def on_duty(self) -> Iterator[None]:
        """Within it the guardian brakes when no beat comes. Raises HostError where it is not there."""
        deadline_s = time.monotonic() + START_LIMIT_S
        while self._cells[cell.STATE] == cell.STARTING:
            if self._process.poll() is not None or time.monotonic() > deadline_s:
                raise HostError("the guardian of the motor could not be started; nothing was driven")
            time.sleep(0.002)
        if not self._cells[cell.REACHES]:
            logger.warning("the guardian reaches the board only once this host has let it go: libusb keeps others out")
        self._own_beat, self._heard_s = 0, time.monotonic()
        self.beat()
        self._cells[cell.ARMED] = 1
        try:
            yield
        finally:
            self._cells[cell.ARMED] = 0

    def beat(self) -> None:
        """The loop goes on."""
        self._cells[cell.BEAT] = (self._cells[cell.BEAT] + 1) & 0xFFFF_FFFF

    @property
    def has_braked(self) -> bool:
        """Whether it had to, since it is on duty."""
        return bool(self._cells[cell.STATE] == cell.TRIPPED)

    def answers(self, now_s: float) -> bool:
        """Whether it lives, and gave a sign of it within DEAF_LIMIT_S; to be asked often."""
        own_beat = self._cells[cell.OWN_BEAT]
        if own_beat != self._own_beat:
            self._own_beat, self._heard_s = own_beat, now_s
            return True
        return now_s - self._heard_s <= self._deaf_s and self._process.poll() is None

    @property
    def pid(self) -> int:
        return self._process.pid

    def close(self, *, braked: bool = True) -> None:
        """The line is closed on purpose: the guardian gives its copy back; where nobody could brake, it tries first."""
        with suppress(OSError):
            if braked:
                self._word.send(b"q")
            else:
                self._word.shutdown(socket.SHUT_WR)
        try:
            self._process.wait(END_LIMIT_S if braked else LAST_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._word.close()


def _memory() -> int:
    """A descriptor of memory to be shared; it goes away with those who have it."""
    if hasattr(os, "memfd_create"):
        fd = os.memfd_create("fiohost-guardian")
    else:
        fd, path = tempfile.mkstemp(prefix="fiohost-guardian-")
        os.unlink(path)
    os.ftruncate(fd, 8 * cell.CELLS)
    return fd
