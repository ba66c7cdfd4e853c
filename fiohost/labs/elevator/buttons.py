"""Two buttons, as a pure state machine: held under half a second one floor, longer two, never beyond the building.

The text does this with a discrete integrator that looks at the button every half second (section D-2-6), so that a
press between two looks is lost and the floors that a press past the top asked for must be taken back one by one. Here
a press counts at once, its second floor after half a second, and the floor itself is limited.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import isfinite

from fiohost.errors import ConfigError
from fiohost.labs.elevator.car import TOP_FLOOR

LONG_S = 0.5
MOST_PRESSES = 1000
LAST_PRESS_S = 600.0
HELD_S = (0.02, 10.0)
SHORT_PRESS_S = 0.2


@dataclass(frozen=True)
class Button:
    """One button: since when it is held (None: it is not), and whether its second floor has been given."""

    since_s: float | None = None
    second: bool = False

    def after(self, time_s: float, pressed: bool) -> tuple[Button, int]:
        """The button at a later moment, and how many floors this moment adds."""
        if not pressed:
            return (self if self.since_s is None else Button()), 0
        if self.since_s is None:
            return Button(time_s), 1
        if not self.second and time_s - self.since_s >= LONG_S:
            return replace(self, second=True), 1
        return self, 0


@dataclass(frozen=True)
class Buttons:
    """Both buttons and the floor that they have asked for so far."""

    floor: int = 0
    up: Button = Button()
    down: Button = Button()

    def after(self, time_s: float, up: bool, down: bool) -> Buttons:
        """The state at a later moment, where each button is pressed or not."""
        new_up, rise = self.up.after(time_s, up)
        new_down, fall = self.down.after(time_s, down)
        if new_up is self.up and new_down is self.down:
            return self
        return Buttons(min(max(self.floor + rise - fall, 0), TOP_FLOOR), new_up, new_down)


@dataclass(frozen=True)
class Press:
    """A button held from a time on."""

    button: str  # "up" or "down"
    at_s: float
    held_s: float = SHORT_PRESS_S


def parse_presses(text: str) -> tuple[Press, ...]:
    """Read ``up@1, up@3:0.7, down@8``: the button, when, and for how long (0.2 s). Raises ConfigError."""
    found = []
    for part in filter(None, (p.strip() for p in text.split(","))):
        button, _, rest = part.partition("@")
        at, _, held = rest.partition(":")
        try:
            press = Press(button.strip().lower(), float(at), float(held) if held else SHORT_PRESS_S)
        except ValueError:
            press = Press("", 0.0)
        if press.button not in ("up", "down"):
            raise ConfigError(f"{part[:40]!r} is not a press: write up@SECONDS or down@SECONDS:HELD, as in up@3:0.7")
        if not (isfinite(press.at_s) and 0.0 <= press.at_s <= LAST_PRESS_S):
            raise ConfigError(f"{part[:40]!r}: a press is at 0 to {LAST_PRESS_S:g} s")
        if not HELD_S[0] <= press.held_s <= HELD_S[1]:
            raise ConfigError(f"{part[:40]!r}: a button is held for {HELD_S[0]:g} to {HELD_S[1]:g} s")
        found.append(press)
    if not 0 < len(found) <= MOST_PRESSES:
        raise ConfigError(f"{len(found)} presses: a ride has 1 to {MOST_PRESSES}")
    return tuple(sorted(found, key=lambda p: p.at_s))


def pressed(presses: Iterable[Press], button: str, time_s: float) -> bool:
    """Whether a button is held at a moment."""
    return any(p.button == button and p.at_s <= time_s < p.at_s + p.held_s for p in presses)


def last_s(presses: Sequence[Press]) -> float:
    """When the last button is let go."""
    return max((p.at_s + p.held_s for p in presses), default=0.0)
