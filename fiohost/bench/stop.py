"""Signals that would end or stop this process become a request that the tick loop reads between two ticks.

Ctrl-C, SIGTERM, SIGHUP, Ctrl-\\ and Ctrl-Z: a process that is stopped would leave the motor as it is, so Ctrl-Z is an
end too.

So no row of the log is torn and no brake is interrupted. A second signal while the loop does not answer (a controller
that hangs) is raised at once; the way out still brakes first.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType, TracebackType
from typing import Any

from fiohost.bench.terminal import not_held_up
from fiohost.errors import FiohostError

_NAMES = {
    "SIGINT": "Ctrl-C",
    "SIGTERM": "SIGTERM",
    "SIGHUP": "SIGHUP (the terminal went away)",
    "SIGQUIT": "Ctrl-\\ (SIGQUIT)",
    "SIGTSTP": "Ctrl-Z (SIGTSTP): a motor cannot wait for fg, so the run ended",
}
_HANG_UP = getattr(signal, "SIGHUP", -1)
_SIGNALS = {getattr(signal, name): said for name, said in _NAMES.items() if hasattr(signal, name)}


class Stopped(KeyboardInterrupt):
    """The run was stopped from outside, after a safe stop. ``exit_code`` is 128 plus the signal's number."""

    def __init__(self, signum: int) -> None:
        super().__init__(f"stopped by {_SIGNALS.get(signum, signum)}")
        self.signum = signum
        self.exit_code = 128 + signum


class StopSignals:
    """While in its context, signals set ``requested`` (the signal's number, 0 before any), and no terminal holds output
    back.

    Outside the main thread, where Python allows no handlers, it changes nothing. A signal that was ignored before
    (nohup, a background job) stays ignored.
    """

    def __init__(self) -> None:
        self.requested = 0
        self._interruptible = False
        self._before: dict[int, Any] = {}
        self._terminal = ExitStack()

    def __enter__(self) -> StopSignals:
        if threading.current_thread() is threading.main_thread():
            for signum in _SIGNALS:
                if signal.getsignal(signum) is not signal.SIG_IGN:
                    self._before[signum] = signal.signal(signum, self._on_signal)
            self._terminal.enter_context(not_held_up())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._terminal.close()
        for signum, handler in self._before.items():
            signal.signal(signum, handler)

    def check(self) -> None:
        """Raise Stopped if a signal has come."""
        if self.requested:
            raise Stopped(self.requested)

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Within it a second signal does not wait for :meth:`check`."""
        self._interruptible = True
        try:
            yield
        finally:
            self._interruptible = False

    @contextmanager
    def hang_ups(self) -> Iterator[None]:
        """What fails for want of the terminal is told as its hang-up: which comes first is chance."""
        try:
            yield
        except (OSError, FiohostError) as exc:
            if self.requested != _HANG_UP:
                raise
            stopped = Stopped(self.requested)
            for note in getattr(exc, "__notes__", ()):
                stopped.add_note(note)
            raise stopped from exc

    def _on_signal(self, signum: int, frame: FrameType | None) -> None:
        if self.requested and self._interruptible:
            self._interruptible = False
            raise Stopped(self.requested)
        self.requested = self.requested or signum
