"""Keys of a terminal, read between two ticks without waiting, and the program that obeys them.

While they are read the terminal passes each key on at once, shows none of them, and Ctrl-Z and Ctrl-\\ are keys without
a meaning. Its settings are put back however the run ends.
"""

from __future__ import annotations

import os
import select
import sys
from contextlib import suppress
from types import TracebackType

from fiohost.bench.program import Answer
from fiohost.errors import FiohostError
from fiohost.panel.controls import Controls
from fiohost.wire.messages import Command

HELP = "up/down 1 %, page up/down 10 %, space brake, s standby, r reverse, q quit"

ACTIONS: dict[str, tuple[str, float | None]] = {
    "up": ("change", 1.0),
    "down": ("change", -1.0),
    "page up": ("change", 10.0),
    "page down": ("change", -10.0),
    " ": ("brake", None),
    "s": ("standby", None),
    "r": ("reverse", None),
}
SEQUENCES = {
    "\x1b[A": "up",
    "\x1bOA": "up",
    "\x1b[B": "down",
    "\x1bOB": "down",
    "\x1b[1;2A": "page up",
    "\x1b[1;2B": "page down",
    "\x1b[a": "page up",  # shift with an arrow, as rxvt has it
    "\x1b[b": "page down",
    "\x1b[5~": "page up",
    "\x1b[6~": "page down",
    "\x1b[5;2~": "page up",
    "\x1b[6;2~": "page down",
}
LONGEST = 32  # of any sequence
MAX_BYTES = 256  # at a time: more is no typing


class Decoder:
    """Characters to keys. A sequence (ESC [ .. final, ESC O x) may come in pieces; an unknown one is passed over."""

    def __init__(self) -> None:
        self._begun = ""

    def keys(self, text: str) -> list[str]:
        found = []
        for char in text:
            if char == "\x1b":
                self._begun = char
            elif self._begun == "\x1b" and char in "[O":
                self._begun += char
            elif len(self._begun) < 2:  # a key, or one after a lone escape
                self._begun = ""
                found.append(char)
            else:
                self._begun += char
                if self._begun[1] == "O" or "@" <= char <= "~" or len(self._begun) > LONGEST:
                    if self._begun in SEQUENCES:
                        found.append(SEQUENCES[self._begun])
                    self._begun = ""
        return found


class Keyboard:
    """A context manager over the terminal at standard input; ``read`` gives the keys since the last time."""

    def __init__(self) -> None:
        self._decoder = Decoder()
        self._fd = sys.stdin.fileno()
        self._before: list[object] | None = None

    def __enter__(self) -> Keyboard:
        import termios

        self._before = termios.tcgetattr(self._fd)
        mode = termios.tcgetattr(self._fd)
        mode[3] &= ~(termios.ICANON | termios.ECHO)
        nothing = b"\0"
        for name in ("VSUSP", "VQUIT", "VDSUSP"):
            if hasattr(termios, name):
                mode[6][getattr(termios, name)] = nothing
        mode[6][termios.VMIN], mode[6][termios.VTIME] = 1, 0
        termios.tcsetattr(self._fd, termios.TCSADRAIN, mode)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        import termios

        if self._before is not None:
            with suppress(termios.error, OSError):  # the terminal may have gone
                termios.tcsetattr(self._fd, termios.TCSADRAIN, self._before)  # type: ignore[arg-type]

    def read(self) -> list[str]:
        """Raises FiohostError where the terminal has gone."""
        try:
            if not select.select([self._fd], [], [], 0.0)[0]:
                return []
            came = os.read(self._fd, MAX_BYTES)
        except OSError as exc:
            raise FiohostError(f"the terminal has gone ({exc.strerror}); the motor was braked") from exc
        if not came:
            raise FiohostError("the terminal has gone; the motor was braked")
        return self._decoder.keys(came.decode(errors="ignore"))


class KeyProgram:
    """Asked by the bench loop: reads the keyboard at each tick until q, or for a number of ticks."""

    def __init__(self, keyboard: Keyboard, command: Command, limit_pct: float, ticks: int | None) -> None:
        self.controls = Controls(limit_pct, command)
        self.shows_help = True
        self._keyboard, self._ticks = keyboard, ticks

    def step(self, k: int, angle_deg: float) -> Answer | None:
        if self._ticks is not None and k >= self._ticks:
            return None
        for key in self._keyboard.read():
            if key in ("q", "Q"):
                return None
            if key in "hH?":
                self.shows_help = not self.shows_help
            elif key.lower() in ACTIONS:
                self.controls.act(*ACTIONS[key.lower()])
        return self.controls.command, None


def has_keys(output: object) -> bool:
    """Whether keys can be read: standard input is a terminal on which we are in front, and *output* is one."""
    try:
        import termios  # not on Windows
    except ImportError:
        return False
    try:
        front = os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError, AttributeError, termios.error):
        return False
    return front and sys.stdin.isatty() and bool(getattr(output, "isatty", lambda: False)())
