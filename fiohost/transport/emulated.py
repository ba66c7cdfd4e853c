"""A board of machine code: the firmware that ships, run by an emulator, in lock step with the simulated motor.

``emulated:uno``, ``emulated:bluepill-l298n:PLANT``, ``emulated:uno:sealed``. Only bytes of the serial line cross over.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from fiohost.boards.images import find_image
from fiohost.errors import ConfigError, DisconnectedError, TelemetryTimeoutError
from fiohost.transport.base import Transport
from fiohost.transport.simulated import DEFAULT_PLANT, _boards

if TYPE_CHECKING:
    from firmware_model.emulated.board import EmulatedBoard
    from firmware_model.emulated.chip import Chip

SEALED_PLANT = "sealed"


def split_emulated(rest: str) -> tuple[str, str]:
    """Image and plant of what follows ``emulated:``. Raises ConfigError."""
    image, _, plant = rest.partition(":")
    if not image:
        raise ConfigError("emulated needs a board: emulated:uno, emulated:bluepill, 'fiohost firmware list'")
    return find_image(image).name, plant


class EmulatedTransport(Transport):
    """Wraps an emulated board; a ``receive`` is one step of its task, whose bytes come as they left its line."""

    lock_step = True
    stream = True

    def __init__(self, board: EmulatedBoard, name: str, identity: str, facts: Mapping[str, str]) -> None:
        self.name, self.identity, self.facts = name, identity, facts
        self._board = board
        self._waiting = b""
        self._is_open = False

    def open(self) -> None:
        self._is_open = True

    def send(self, report: bytes) -> None:
        self._check()
        self._waiting += report

    def receive(self, timeout_s: float) -> bytes:
        self._check()
        waiting, self._waiting = self._waiting, b""
        came = self._board.step(waiting)
        if not came:
            raise TelemetryTimeoutError("the emulated board sent nothing in this step")
        return came

    def close(self) -> None:
        self._is_open = False

    def _check(self) -> None:
        if not self._is_open:
            raise DisconnectedError("the line to the emulated board is closed")


def emulated_board(rest: str, seed: int | None = None) -> EmulatedTransport:
    """A board by what follows ``emulated:``; *seed* as of a simulated one, or which sealed plant it is.

    Raises ConfigError for an unknown board or plant, and where the emulator is not installed.
    """
    from firmware_model import FirmwareModelError, draw, load_plant
    from firmware_model.emulated.board import EmulatedBoard
    from firmware_model.sealed import NEWEST

    name, plant_name = split_emulated(rest)
    image = find_image(name)
    try:
        sealed = plant_name == SEALED_PLANT
        plant = draw(seed or 0) if sealed else load_plant(plant_name or DEFAULT_PLANT)
        chip = _chip(image.board.name)(image.hex_path)
        board = EmulatedBoard(chip, plant, image.board.name, image.bridge, seed=seed)
    except FirmwareModelError as exc:
        raise ConfigError(str(exc)) from exc
    identity = f"emulated {image.board.chip}, {image.name}" + ", sealed" * sealed
    facts = {"plant": plant.name, "supply_V": f"{plant.supply_V:g}", "pwm_hz": f"{plant.pwm_hz:g}"}
    if sealed:
        facts = {"sealed_version": str(NEWEST)}
    transport = EmulatedTransport(board, f"emulated:{rest}", identity, facts)
    if not sealed:
        _boards[transport] = board
    return transport


def _chip(board: str) -> Callable[[Path], Chip]:
    if board == "uno":
        from firmware_model.emulated.avr import Atmega328p

        return Atmega328p
    from firmware_model.emulated.arm import Stm32

    return Stm32
