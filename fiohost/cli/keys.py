"""Keys of a terminal, read as they are pressed, without waiting for the return key."""

from __future__ import annotations

import os
import sys
from types import TracebackType
from typing import Any, Self

from fiohost.errors import ConfigError

_ARROWS = {"\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left"}
_WINDOWS_ARROWS = {"H": "up", "P": "down", "M": "right", "K": "left"}


class Keys:
    """While in its context, ``read`` gives the keys pressed since the last call: characters, and arrows by name.

    Ctrl-C stays a signal. A terminal tells no release of a key. Raises ConfigError where standard input is none.
    """

    def __init__(self) -> None:
        if not sys.stdin.isatty():
            raise ConfigError("keys are read from a terminal, and standard input is none")
        self._before: Any = None

    def __enter__(self) -> Self:
        if sys.platform != "win32":
            import termios
            import tty

            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if sys.platform != "win32":
            import termios

            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, self._before)

    def read(self) -> list[str]:
        """Never waits."""
        if sys.platform == "win32":
            import msvcrt

            found = []
            while msvcrt.kbhit():
                key = msvcrt.getwch()
                found.append(_WINDOWS_ARROWS.get(msvcrt.getwch(), "") if key in "\x00\xe0" else key)
            return [key for key in found if key]
        import select

        if not select.select([sys.stdin], [], [], 0.0)[0]:
            return []
        return split_keys(os.read(sys.stdin.fileno(), 256).decode("utf-8", "ignore"))


def split_keys(text: str) -> list[str]:
    """Characters and arrows (by name) of what a terminal sent."""
    found, i = [], 0
    while i < len(text):
        arrow = _ARROWS.get(text[i : i + 3])
        found.append(arrow or text[i])
        i += 3 if arrow else 1
    return found
