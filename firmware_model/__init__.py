"""The device at the other end of the wire: a simulated STM32 board with bridge, timer, encoder, motor and load.

It knows nothing of the host. ``Board.step`` takes the bytes of a report and returns the bytes of a telemetry report.
The names below are loaded on first use, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from firmware_model.board import Board
    from firmware_model.errors import FirmwareModelError
    from firmware_model.faults import FaultyBoard
    from firmware_model.formats import Receiver, make_format
    from firmware_model.instruments import Instruments
    from firmware_model.plants import Plant, load_plant, plant_names
    from firmware_model.sealed import draw, reveal

_WHERE = {
    "Board": "board",
    "Receiver": "formats",
    "FaultyBoard": "faults",
    "FirmwareModelError": "errors",
    "Instruments": "instruments",
    "Plant": "plants",
    "draw": "sealed",
    "load_plant": "plants",
    "make_format": "formats",
    "plant_names": "plants",
    "reveal": "sealed",
}

__all__ = [
    "Board",
    "FaultyBoard",
    "FirmwareModelError",
    "Instruments",
    "Plant",
    "Receiver",
    "draw",
    "load_plant",
    "make_format",
    "plant_names",
    "reveal",
]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
    globals()[name] = value
    return value
