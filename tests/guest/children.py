"""Programs in the guest, each in a process of its own.

They are forked from one that has everything imported, since an emulated Python takes half a minute for that.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from typing import ClassVar

Main = Callable[[Sequence[str]], object]


class StepFailed(Exception):
    """Something was not as it must be; the text says what."""


def check(true: object, what: str) -> None:
    if not true:
        raise StepFailed(what)


class Child:
    """A command in a process of its own. ``lines``: what it said, each with the (monotonic) time when it was read."""

    _all: ClassVar[list[Child]] = []

    def __init__(self, name: str, main: Main, arguments: Sequence[str]) -> None:
        self.text = " ".join([name, *arguments])
        self.code: int | None = None
        self.lines: list[tuple[float, str]] = []
        self.began_s = time.monotonic()
        self.ended_s = self.cpu_s = 0.0
        sys.stdout.flush()
        self._pipe, write = os.pipe()
        self.pid = os.fork()
        if not self.pid:
            _become(main, arguments, write)
        os.close(write)
        os.set_blocking(self._pipe, False)
        self._rest = b""
        self._is_open = True
        self._all.append(self)

    def wait(self, limit_s: float = 120.0) -> int:
        """Its exit code (negative: of a signal). Raises StepFailed where it does not end in time."""
        self.wait_for(lambda: self.code is not None, limit_s, "ends")
        assert self.code is not None
        return self.code

    def wait_for(self, true: Callable[[], bool], limit_s: float, what: str, every_s: float = 0.05) -> None:
        """Read what it says until something is *true*. Raises StepFailed."""
        deadline_s = time.monotonic() + limit_s
        while True:
            self._look(every_s)
            if true():
                return
            if time.monotonic() > deadline_s:
                raise StepFailed(f"'{self.text}': no '{what}' within {limit_s:g} s; it said: {self.said()[-300:]!r}")
            if self.code is not None:
                raise StepFailed(f"'{self.text}' ended with {self.code} before '{what}': {self.said()[-300:]!r}")

    def wait_line(self, words: str, limit_s: float = 60.0) -> float:
        """When a line with *words* was read."""
        self.wait_for(lambda: self.line_s(words) > 0.0, limit_s, words)
        return self.line_s(words)

    def line_s(self, words: str) -> float:
        return next((at_s for at_s, line in self.lines if words in line), 0.0)

    def said(self) -> str:
        return "\n".join(line for _, line in self.lines)

    def kill(self, number: int = signal.SIGKILL) -> None:
        if self.code is None:
            os.kill(self.pid, number)

    @classmethod
    def end_all(cls, name: str) -> None:
        """Kill what still runs of that name."""
        for child in cls._all:
            if child.text.startswith(name):
                child.kill()

    def _look(self, wait_s: float) -> None:
        if self._is_open:
            select.select([self._pipe], [], [], wait_s)
            try:
                data = os.read(self._pipe, 65536)
            except BlockingIOError:
                return
            now_s = time.monotonic()
            *whole, self._rest = (self._rest + data).split(b"\n")
            self.lines += [(now_s, line.decode(errors="replace")) for line in whole]
            if data:
                return
            os.close(self._pipe)
            self._is_open = False
        if self.code is None:
            _, status, usage = os.wait4(self.pid, 0)
            self.cpu_s = usage.ru_utime + usage.ru_stime
            self.code = os.waitstatus_to_exitcode(status)
            self.ended_s = time.monotonic()


def _become(main: Main, arguments: Sequence[str], write: int) -> None:
    """In the child: run *main* as the command it is, and end."""
    os.dup2(write, 1)
    os.dup2(write, 2)
    os.close(write)
    code = 1
    try:
        result = main(list(arguments))
        code = result if isinstance(result, int) else 0
    except SystemExit as exc:
        code = exc.code if isinstance(exc.code, int) else 0 if exc.code is None else 1
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
