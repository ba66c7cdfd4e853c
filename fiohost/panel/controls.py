"""What a person has asked for last, as a command for the bridge.

All ways of asking (key, slider, button) come through :meth:`Controls.act`, which bounds and checks what it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from fiohost.errors import LimitError
from fiohost.panel.sources import Loop, Source
from fiohost.settings import nearest
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

SANE_PCT = 1e6  # beyond it a value is no slip of the hand; NaN and infinity are outside too


class Controls:
    """Holds one command; begins with the brake. After ``emergency`` nothing but ``release`` is obeyed."""

    def __init__(
        self, limit_pct: float = 100.0, command: Command = BRAKE_COMMAND, sample_time_s: float = 0.005
    ) -> None:
        self.limit_pct, self.sample_time_s = limit_pct, sample_time_s
        self._runs: Source | Loop | None = None  # what drives in the place of a hand
        self._began_s: float | None = None
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
        """Do one action: ``duty`` and ``change`` take percent, which is bounded by the target's limit; ``source`` and
        ``loop`` take their settings by name; others nothing. Any of them ends a source or loop but a change of itself.

        Raises LimitError for an unknown action and for a value that makes no sense.
        """
        if name in ("source", "loop"):
            self._begin(name, value)
            return
        if name in self._valued:
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not -SANE_PCT <= value <= SANE_PCT:
                raise LimitError(f"{name} needs a finite number, not {str(value)[:40]!r}")
            if not self.stopped:
                self._runs = None
                self.command = self._valued[name](value)
        elif name not in self._actions:
            raise LimitError(f"unknown action {name[:40]!r}; {nearest(name[:40], [*self._actions, *self._valued])}")
        elif not self.stopped or name in ("emergency", "release"):
            self._runs = None
            self.command = self._actions[name]()

    @property
    def doing(self) -> str:
        """``hand``, ``source`` or ``loop``."""
        return "hand" if self._runs is None else "source" if isinstance(self._runs, Source) else "loop"

    @property
    def drives(self) -> bool:
        """Whether the motor is driven, or may be in the next tick."""
        return self._runs is not None or bool(self.command.duty_pct)

    def answer(self, time_s: float, angle_deg: float) -> tuple[Command, float | None]:
        """The command of this tick, and the reference in degrees where there is one."""
        ref = None
        if self._runs is not None:
            if self._began_s is None:
                self._began_s = time_s
            passed = time_s - self._began_s
            if isinstance(self._runs, Source):
                self.command = self._drive(self._runs.at(passed))
            else:
                duty, ref = self._runs.step(passed, angle_deg)
                self.command = self._drive(duty)
        return self.command, ref

    def _begin(self, name: str, value: object) -> None:
        if not isinstance(value, Mapping):
            raise LimitError(f"{name} needs its settings by name")
        if name == "loop" and isinstance(self._runs, Loop):
            before = self._runs.source
            self._runs.change(value)
            if self._runs.source != before:
                self._began_s = None
            return
        made = (
            Source.read(value, self.limit_pct) if name == "source" else Loop(value, self.sample_time_s, self.limit_pct)
        )
        if not self.stopped:
            self._runs, self._began_s = made, None

    def _drive(self, duty_pct: float) -> Command:
        return Command.drive(max(-self.limit_pct, min(self.limit_pct, duty_pct)))

    def _emergency(self) -> Command:
        self.stopped = True
        return BRAKE_COMMAND

    def _release(self) -> Command:
        """Drive is allowed again; the brake holds until someone asks for it."""
        self.stopped = False
        return BRAKE_COMMAND
