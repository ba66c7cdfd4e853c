"""The terminal while a motor is driven: nothing typed there may hold this process up.

Ctrl-S holds back all output, and a process that writes then waits for Ctrl-Q with the motor running; so flow control by
characters is off meanwhile. A background job of a terminal with ``tostop`` is not stopped for what it writes.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

_STOPS_FOR_OUTPUT = ("SIGTTOU", "SIGTTIN")


@contextmanager
def not_held_up() -> Iterator[None]:
    """Within it no output to a terminal is held back. To be entered in the main thread; settings are put back."""
    with ExitStack() as undo:
        for name in _STOPS_FOR_OUTPUT:
            number = getattr(signal, name, None)
            if number is not None:
                undo.callback(signal.signal, number, signal.signal(number, signal.SIG_IGN))
        for stream in (sys.stdin, sys.stdout, sys.stderr):
            _without_flow_control(stream, undo)
        yield


def _without_flow_control(stream: Any, undo: ExitStack) -> None:
    try:
        import termios  # not on Windows
    except ImportError:
        return
    try:
        fd = stream.fileno()
        if not os.isatty(fd) or os.tcgetpgrp(fd) != os.getpgrp():  # not ours to set, or in the background
            return
        before = termios.tcgetattr(fd)
        mode = termios.tcgetattr(fd)
        if not mode[0] & termios.IXON:
            return
        mode[0] &= ~termios.IXON
        termios.tcsetattr(fd, termios.TCSANOW, mode)  # also lets go what Ctrl-S holds already
    except (OSError, ValueError, AttributeError, termios.error):
        return

    def put_back() -> None:
        with suppress(OSError, ValueError, termios.error):  # the terminal may have gone
            termios.tcsetattr(fd, termios.TCSANOW, before)

    undo.callback(put_back)
