"""The car on a bench and on the model, from the same demand."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fiohost.bench.log import Log
from fiohost.bench.program import Answer
from fiohost.control.closed_loop import Plant, run_loop
from fiohost.control.law import ControlLaw
from fiohost.control.settings import ControlSettings
from fiohost.labs.elevator.buttons import MOST_PRESSES, SHORT_PRESS_S, Buttons, Press, last_s, pressed
from fiohost.labs.elevator.car import DEG_PER_CM, FLOOR_CM, Record, floor_cm
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.wire.messages import Command

Demand = Callable[[float], float | None]  # seconds -> height in cm, None ends the run

WAIT_S = 1.0  # before the first move
STAY_S = 2.0  # on a floor, as in the text
RIDE_END_S = 3.0  # after the last press
LONG_PRESS_S = 0.7
BETWEEN_S = 0.05  # two keys in a row press the button twice
KEYS = {
    **dict.fromkeys(("u", "up"), ("up", SHORT_PRESS_S)),
    **dict.fromkeys(("U", "page up"), ("up", LONG_PRESS_S)),
    **dict.fromkeys(("d", "down"), ("down", SHORT_PRESS_S)),
    **dict.fromkeys(("D", "page down"), ("down", LONG_PRESS_S)),
}


def up_and_down(time_s: float) -> float | None:
    """Up one floor and back, two seconds each (Fig. D-41)."""
    if time_s < WAIT_S:
        return 0.0
    if time_s < WAIT_S + STAY_S:
        return FLOOR_CM
    return 0.0 if time_s < WAIT_S + 2.0 * STAY_S else None


class ByButtons:
    """The demand of two buttons, by a list of presses; it ends some seconds after the last."""

    def __init__(self, presses: Sequence[Press]) -> None:
        self.presses = list(presses)
        self._until_s = last_s(presses) + RIDE_END_S
        self._buttons = Buttons()

    @property
    def floor(self) -> int:
        """The floor that is asked for."""
        return self._buttons.floor

    def __call__(self, time_s: float) -> float | None:
        return None if time_s >= self._until_s else self._height_cm(time_s)

    def _height_cm(self, time_s: float) -> float:
        up, down = (pressed(self.presses, button, time_s) for button in ("up", "down"))
        self._buttons = self._buttons.after(time_s, up, down)
        return floor_cm(self._buttons.floor)


class ByKeys(ByButtons):
    """The demand of keys as they come: u, d or an arrow press a button shortly, U, D or shift with an arrow hold it.

    *read* gives the keys since it was last asked; q ends. A terminal tells no release, so how long is ours.
    """

    def __init__(self, read: Callable[[], Sequence[str]]) -> None:
        super().__init__(())
        self._read = read
        self._free_s = dict.fromkeys(("up", "down"), 0.0)

    def __call__(self, time_s: float) -> float | None:
        for key in self._read():
            if key in ("q", "Q"):
                return None
            button, held_s = KEYS.get(key, ("", 0.0))
            if button and len(self.presses) < MOST_PRESSES:
                at_s = max(time_s, self._free_s[button])
                self.presses.append(Press(button, at_s, held_s))
                self._free_s[button] = at_s + held_s + BETWEEN_S
        return self._height_cm(time_s)


class Ride:
    """A program of the bench: the law takes the car to the height that is demanded, the first reading being zero."""

    def __init__(self, law: ControlLaw, demand: Demand, sample_time_s: float) -> None:
        self._law, self._demand, self._tick_s = law, demand, sample_time_s
        self._zero_deg: float | None = None
        law.reset()

    def step(self, k: int, angle_deg: float) -> Answer | None:
        if self._zero_deg is None:
            self._zero_deg = angle_deg
        height_cm = self._demand(k * self._tick_s)
        if height_cm is None:
            return None
        ref_deg = self._zero_deg + DEG_PER_CM * height_cm
        return Command.drive(self._law.step(ref_deg, angle_deg)), ref_deg


def record_of(log: Log) -> Record:
    """A bench's log of a ride as heights above its first reading."""
    zero = log.output[0]
    return Record(
        log.time_s,
        np.round((log.columns["ref_deg"] - zero) / DEG_PER_CM, 6),
        (log.output - zero) / DEG_PER_CM,
        log.duty_pct,
    )


def on_model(model: Model, settings: ControlSettings, log: Log) -> Record:
    """What the model does with the demand of a log, from rest, at the bench's tick, delay and encoder counts."""
    tick_s = log.sample_time_s
    n = round(float(log.time_s[-1]) / tick_s) + 1
    row = np.searchsorted(log.time_s, np.arange(n) * tick_s + 0.5 * tick_s, side="right") - 1
    refs_deg = (log.columns["ref_deg"] - log.output[0])[np.maximum(row, 0)]
    loop = settings.loop(tick_s, log.command_delay_ticks * tick_s, log.output_quantum)
    run = run_loop(Plant.of(model), loop, refs_deg, Start(0.5 * log.output_quantum, 0.0))
    heights = run.angle_deg / DEG_PER_CM
    return Record(run.time_s, np.round(run.ref_deg / DEG_PER_CM, 6), heights, run.duty_pct)
