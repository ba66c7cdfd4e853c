"""Emulators and compilers for the firmware's tests: absent ones skip loudly, with FIOHOST_NEEDS_FIRMWARE they fail."""

from __future__ import annotations

import importlib.util
import os
import shutil
from pathlib import Path

import pytest

from fiohost.boards.images import find_image
from firmware_model import FirmwareModelError, Plant, load_plant
from firmware_model.emulated.board import EmulatedBoard

BOARDS = ("uno", "bluepill")
DUTY_STEPS = {"uno": 800, "bluepill": 3600}


def absent(reason: str) -> None:
    """Skip loudly; in the gate fail."""
    text = f"FIRMWARE NOT TESTED: {reason}"
    if os.environ.get("FIOHOST_NEEDS_FIRMWARE"):
        pytest.fail(text)
    pytest.skip(text)


def needed(*programs: str) -> None:
    """Skip loudly where a program is absent."""
    missing = [name for name in programs if shutil.which(name) is None]
    if missing:
        absent(f"no {', '.join(missing)} (apt-get install gcc libc6-dev make gcc-avr avr-libc gcc-arm-none-eabi)")


def emulator(board: str) -> None:
    """Skip loudly where there is no emulator of this board."""
    if board == "uno":
        from firmware_model.emulated.avr import library

        try:
            library()
        except FirmwareModelError as exc:
            absent(str(exc))
    elif importlib.util.find_spec("unicorn") is None:
        absent("no unicorn (pip install unicorn)")


def chip(name: str, image: Path | None = None):  # type: ignore[no-untyped-def]
    """The emulated chip of a board, or of a board and a bridge, with its program or another *image*."""
    found = find_image(name)
    emulator(found.board.name)
    if found.board.name == "uno":
        from firmware_model.emulated.avr import Atmega328p

        return Atmega328p(image or found.hex_path)
    from firmware_model.emulated.arm import Stm32

    return Stm32(image or found.hex_path)


def board(name: str, plant: str | Plant = "ideal", *, image: Path | None = None) -> EmulatedBoard:
    """An emulated board with its motor."""
    found = find_image(name)
    motor = load_plant(plant) if isinstance(plant, str) else plant
    return EmulatedBoard(chip(name, image), motor, found.board.name, found.bridge)
