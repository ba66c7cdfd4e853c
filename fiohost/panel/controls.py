"""What a person has asked for last, as a command for the bridge.

All ways of asking (key, slider, button) come through :meth:`Controls.act`, which bounds and checks what it is given.
"""

from __future__ import annotations

from collections.abc import Callable

from fiohost.errors import LimitError
from fiohost.settings import nearest
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

SANE_PCT = 1e6  # beyond it a value is no slip of the hand; NaN and infinity are outside too


class Controls:
    """Holds one command; begins with the brake. After ``emergency`` nothing but ``release`` is obeyed."""

    def __init__(self, limit_pct: float = 100.0, command: Command = BRAKE_COMMAND) -> None:
        self.limit_pct = limit_pct
        self.command = command
        self.stopped = False  # the emergency stop is latched
        self._actions: dict[str, Callable[[], Command]] = {
            "brake": lambda: BRAKE_COMMAND,
            "standby": lambda: STANDBY_COMMAND,
            "reverse": lambda: self._drive(-self.command.duty_pct),
            "emergency": self._emergency,
            "release": self._release,
        }
        self._valued: dict[str, Callable[[float], Command]] = {
            "duty": self._drive,
            "change": lambda by_pct: self._drive(self.command.duty_pct + by_pct),
        }

    def act(self, name: str, value: object = None) -> None:
        """Do one action: ``duty`` and ``change`` take percent, which is bounded by the target's limit, others nothing.

        Raises LimitError for an unknown action and for a value that is no finite number.
        """
        if name in self._valued:
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not -SANE_PCT <= value <= SANE_PCT:
                raise LimitError(f"{name} needs a finite number, not {str(value)[:40]!r}")
            if not self.stopped:
                self.command = self._valued[name](value)
        elif name not in self._actions:
            raise LimitError(f"unknown action {name[:40]!r}; {nearest(name[:40], [*self._actions, *self._valued])}")
        elif not self.stopped or name in ("emergency", "release"):
            self.command = self._actions[name]()

    def _drive(self, duty_pct: float) -> Command:
        return Command.drive(max(-self.limit_pct, min(self.limit_pct, duty_pct)))

    def _emergency(self) -> Command:
        self.stopped = True
        return BRAKE_COMMAND

    def _release(self) -> Command:
        """Drive is allowed again; the brake holds until someone asks for it."""
        self.stopped = False
        return BRAKE_COMMAND
