"""The guardian: a process of its own that brakes the motor when its host no longer can.

Started with a copy of the line (or a way to open it), it looks at a counter in shared memory that the host's loop moves
on at each tick. Where the host is to drive and the counter stands still, or the host has died, it sends the brake, once
a step, until the host takes over or, after a death, for some time. It imports nothing of fiohost and little else:
whatever goes wrong there does not go wrong here.

Run as ``python -I -S guardian_process.py SETTINGS`` with the host's socket as standard input; SETTINGS is JSON.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import select
import signal
import sys
import time
from typing import Any

CELLS = 6
BEAT, ARMED, STATE, OWN_BEAT, TRIPS, REACHES = range(CELLS)  # what each cell of the shared memory holds
STARTING, READY, TRIPPED = range(3)  # values of STATE

IDLE_S = 0.05
GONE_S = 0.5  # the brake goes out for so long after the host has died
DEATH = "fiohost: the host died; its guardian sent the brake for {:g} s: see that the motor stands\n"


class LineOut:
    """The board's line, to write to: a descriptor, a node, or a device of a hidapi module. Opened when it can be."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self._fd: int = settings["fd"]
        self._path: str = settings["path"]
        self._module: str = settings["module"]
        self._device: Any = None
        self._prefix = bytes.fromhex(settings["prefix"])

    def open(self) -> bool:
        """Whether the line can be written to now."""
        if self._fd >= 0 or self._device is not None:
            return True
        with contextlib.suppress(Exception):
            if not self._module:
                self._fd = os.open(self._path, os.O_RDWR | os.O_CLOEXEC)
            else:
                device = __import__(self._module).device()
                device.open_path(os.fsencode(self._path))
                self._device = device
        return self._fd >= 0 or self._device is not None

    def send(self, report: bytes) -> None:
        """Whatever is the matter with the line, it is tried again with the next one."""
        with contextlib.suppress(Exception):
            if not self.open():
                return
            if self._fd >= 0:
                os.write(self._fd, self._prefix + report)
            else:
                self._device.write(self._prefix + report)

    def close(self) -> None:
        with contextlib.suppress(Exception):
            if self._fd >= 0:
                os.close(self._fd)
            elif self._device is not None:
                self._device.close()


def main(text: str) -> None:
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP", "SIGPIPE", "SIGTTOU"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    settings = json.loads(text)
    cells = memoryview(mmap.mmap(settings["memory"], 8 * CELLS)).cast("Q")
    line = LineOut(settings)
    cells[REACHES] = line.open()
    cells[STATE] = READY
    died = watch(line, cells, settings)
    line.close()
    if died:
        _say(DEATH.format(GONE_S))


def watch(line: LineOut, cells: memoryview, settings: dict[str, Any]) -> bool:
    """Until the host says that it ends, or is dead: whether it died with the line open."""
    frames = [bytes.fromhex(frame) for frame in settings["frames"]]
    limit_s, step_s = settings["limit_s"], settings["step_s"]
    beat, seen_s, sent = cells[BEAT], time.monotonic(), 0
    dead_s = 0.0
    while True:
        wait_s = step_s if cells[ARMED] or dead_s else IDLE_S
        if dead_s:
            time.sleep(wait_s)
        elif select.select([0], [], [], wait_s)[0]:
            word = os.read(0, 1)
            if word:
                return False
            dead_s = time.monotonic()
        now_s = time.monotonic()
        cells[OWN_BEAT] += 1
        if cells[BEAT] != beat:
            beat, seen_s = cells[BEAT], now_s
        if not cells[ARMED] and cells[STATE] == TRIPPED:
            cells[STATE] = READY
        if cells[ARMED] and cells[STATE] != TRIPPED and now_s - seen_s > limit_s:
            cells[STATE] = TRIPPED
            cells[TRIPS] += 1
        if dead_s or (cells[ARMED] and cells[STATE] == TRIPPED):
            line.send(frames[sent % len(frames)])
            sent += 1
        if dead_s and now_s - dead_s > GONE_S:
            return True


def _say(text: str) -> None:
    with contextlib.suppress(OSError, ValueError):
        if select.select([], [2], [], 0.0)[1]:  # a reader who has stopped reading must not hold us
            os.write(2, text.encode())


if __name__ == "__main__":
    main(sys.argv[1])
