"""The car on a bench and on the model, from the same demand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf

import numpy as np

from fiohost.bench.log import Log
from fiohost.bench.program import Answer
from fiohost.control.law import ControlLaw
from fiohost.control.settings import ControlSettings
from fiohost.labs.constants import MotorConstants
from fiohost.labs.elevator.buttons import MOST_PRESSES, SHORT_PRESS_S, Buttons, Press, last_s, pressed
from fiohost.labs.elevator.car import DEG_PER_CM, DRUM_CM, FLOOR_CM, LOAD_NM, Design, Record, floor_cm
from fiohost.labs.play import Limits, Torque, Way, play_model
from fiohost.labs.problems.servo import POSITION, Servo
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


class _Following:
    """A control law on heights known beforehand, as the model asks it; keeps what it sent."""

    def __init__(self, settings: ControlSettings, refs_deg: np.ndarray, sample_time_s: float) -> None:
        self._law, self._refs = settings.law(sample_time_s), refs_deg.tolist()
        self._law.reset()
        self.sent_pct: list[float] = []

    def step(self, k: int, angle_deg: float) -> tuple[float, float]:
        ref = self._refs[min(k, len(self._refs) - 1)]
        duty = self._law.step(ref, angle_deg)
        self.sent_pct.append(duty)
        return duty, ref

    def applied(self, duty_pct: float) -> None:
        pass  # the law has its own limit and knows what it cut


def _on(
    motor: MotorConstants, settings: ControlSettings, refs_deg: np.ndarray, way: Way, limit_A: float | None
) -> Record:
    """The car from rest: the motor at its full voltage, a limit of its current, the weight against upward motion."""
    law = _Following(settings, refs_deg, way.sample_time_s)
    limits = Limits(motor.supply_V, limit_A)
    run = play_model(motor, law, (len(refs_deg) - 1) * way.sample_time_s, way, limits=limits, torque=Torque(-LOAD_NM))
    refs, sent = (np.array(values)[: len(run.time_s)] for values in (run.ref, law.sent_pct))
    return Record(run.time_s, np.round(refs / DEG_PER_CM, 6), run.angle_deg / DEG_PER_CM, sent)


def on_model(motor: MotorConstants, settings: ControlSettings, log: Log, limit_A: float | None) -> Record:
    """What the model does with the demand of a log, from rest, at the bench's tick, delay and encoder counts."""
    tick_s = log.sample_time_s
    n = round(float(log.time_s[-1]) / tick_s) + 1
    row = np.searchsorted(log.time_s, np.arange(n) * tick_s + 0.5 * tick_s, side="right") - 1
    refs_deg = (log.columns["ref_deg"] - log.output[0])[np.maximum(row, 0)]
    way = Way("model", tick_s, log.command_delay_ticks * tick_s, log.output_quantum)
    return _on(motor, settings, refs_deg, way, limit_A)


def ideal(motor: MotorConstants, design: Design, limit_A: float | None) -> Record:
    """The text's block diagram (Fig. D-35): up at once, down after two seconds; no ticks, no delay, no counts."""
    servo = Servo(
        motor, FLOOR_CM / DRUM_CM, POSITION, design.kp_V_per_rad, design.ki_V_per_rad_s, design.kd_V_s_per_rad,
        load_Nm=-LOAD_NM, limit_V=0.01 * design.power_pct * motor.supply_V,
        limit_A=inf if limit_A is None else limit_A, second_ref=0.0, second_from_s=STAY_S,
    )  # fmt: skip
    found = servo.run(2.0 * STAY_S)
    asked_cm = np.where(found.time_s < STAY_S, FLOOR_CM, 0.0)
    columns = (found.time_s, asked_cm, DRUM_CM * found.angle, 100.0 / motor.supply_V * found.volts)
    before = (-found.time_s[1], 0.0, 0.0, 0.0)  # at rest, so that the step at 0 is seen as one
    return Record(*(np.concatenate(([first], rest)) for first, rest in zip(before, columns, strict=True)))
