"""A simulated board in this process, in lock step: each ``receive`` is one task step of the firmware model.

Only report bytes cross this line. What the board is made of stays behind it; of a sealed board nothing is told but the
version of its draws, so that its logs tell nothing either.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from fiohost.errors import ConfigError, DisconnectedError, TelemetryTimeoutError
from fiohost.files import note_input
from fiohost.transport.base import Transport
from fiohost.transport.profile import DEFAULT_BOARD_LAYOUT

if TYPE_CHECKING:
    from firmware_model import Board, Plant
    from firmware_model.emulated.board import EmulatedBoard

DEFAULT_PLANT = "default"

Step = Callable[[bytes | None], bytes | list[bytes]]

# For the lab's instruments alone: the boards behind open plants. A sealed one has no meters.
_boards: WeakKeyDictionary[Transport, Board | EmulatedBoard] = WeakKeyDictionary()


class SimulatedTransport(Transport):
    """Wraps the step function of a board: ``step(newest report or None) -> telemetry``, or all reports that came."""

    lock_step = True

    def __init__(
        self,
        step: Step,
        name: str,
        identity: str,
        facts: Mapping[str, str] | None = None,
        counts_per_rev: int | None = None,
    ) -> None:
        self.name = name
        self.identity = identity
        self.facts = dict(facts or {})
        self.counts_per_rev = counts_per_rev
        self._step = step
        self._newest: bytes | None = None
        self._is_open = False

    def open(self) -> None:
        self._is_open = True

    def send(self, report: bytes) -> None:
        if not self._is_open:
            raise DisconnectedError("the line to the simulated board is closed")
        self._newest = report

    def receive(self, timeout_s: float) -> bytes:
        if not self._is_open:
            raise DisconnectedError("the line to the simulated board is closed")
        newest, self._newest = self._newest, None
        came = self._step(newest)
        if isinstance(came, bytes):
            return came
        if not came:
            raise TelemetryTimeoutError("the simulated board sent nothing in this tick")
        self.passed_over += len(came) - 1
        return came[-1]

    def close(self) -> None:
        self._is_open = False


def plant_board(
    plant_name: str, seed: int | None = None, *, layout: str = DEFAULT_BOARD_LAYOUT, duty_steps: int = 0
) -> SimulatedTransport:
    """A board with a plant by name or file. Raises ConfigError for a plant that is unknown or malformed.

    *layout*: the reports that the board speaks, by its own name of them. *duty_steps*: timer counts of a PWM period;
    0 are the 3600 of the real one.
    """
    from firmware_model import FirmwareModelError, load_plant, plant_names

    if plant_name and plant_name not in plant_names():
        note_input(plant_name, ConfigError)  # the firmware model reads it by itself
    try:
        plant = load_plant(plant_name or DEFAULT_PLANT)
        board = _make(plant, seed, layout, duty_steps)
    except FirmwareModelError as exc:
        raise ConfigError(str(exc)) from exc
    name = f"sim:{plant_name}" if plant_name else "sim"
    facts = {"plant": plant.name, "supply_V": f"{plant.supply_V:g}", "pwm_hz": f"{plant.pwm_hz:g}"}
    transport = SimulatedTransport(_line(board, plant, seed), name, "simulated", facts, plant.counts_per_rev)
    _boards[transport] = board
    return transport


def sealed_board(
    seed: int, *, faulty: bool = False, layout: str = DEFAULT_BOARD_LAYOUT, duty_steps: int = 0
) -> SimulatedTransport:
    """A board whose plant, effects and, where asked for, faults are drawn by *seed* and told to nobody."""
    from firmware_model import draw
    from firmware_model.sealed import NEWEST

    plant = draw(seed, faulty=faulty)
    step = _line(_board(plant, seed, layout, duty_steps), plant, seed)
    name = "sim:sealed-faulty" if faulty else "sim:sealed"
    facts = {"sealed_version": str(NEWEST)}
    return SimulatedTransport(step, name, "simulated, sealed", facts, plant.counts_per_rev)


def _make(plant: Plant, seed: int | None, layout: str, duty_steps: int) -> Board:
    from firmware_model import Board
    from firmware_model.report import PERIOD

    return Board(plant, seed=seed, layout=layout, duty_steps=duty_steps or PERIOD)


def _board(plant: Plant, seed: int, layout: str, duty_steps: int) -> Board:
    from firmware_model import FirmwareModelError

    try:
        return _make(plant, seed, layout, duty_steps)
    except FirmwareModelError as exc:
        raise ConfigError(str(exc)) from exc


def _line(board: Board, plant: Plant, seed: int | None) -> Step:
    """The board's step, through the faults of its line and clock where it has any."""
    if plant.faults is None:
        return board.step
    from firmware_model import FaultyBoard

    return FaultyBoard(board, plant.faults, seed=seed).step


def list_plants() -> list[dict[str, str]]:
    """The plants that a simulated board can have: name and source of each."""
    from firmware_model import load_plant, plant_names

    return [{"name": name, "source": load_plant(name).source} for name in plant_names()]
