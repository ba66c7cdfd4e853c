"""The firmware that ships: one program for each board and bridge, as .hex and .bin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from fiohost.errors import ConfigError
from fiohost.settings import nearest

_PACKAGE = Path(__file__).parent
BRIDGES: Mapping[str, str] = MappingProxyType(
    {
        "tb6612": "TB6612 and its like: PWM, IN1, IN2, STBY; slow decay",
        "l298n": "L298N with the PWM on ENA; fast decay",
        "drv8833": "DRV8833 and its like: PWM on IN1 and IN2; slow decay",
    }
)
DEFAULT_BRIDGE = "tb6612"


@dataclass(frozen=True)
class Board:
    """A board that there is firmware for. Its *name* is that of its target profile too."""

    name: str
    title: str
    chip: str


BOARDS: Mapping[str, Board] = MappingProxyType(
    {
        board.name: board
        for board in (
            Board("uno", "Arduino Uno and Nano", "ATmega328P"),
            Board("bluepill", "Blue Pill", "STM32F103C8"),
        )
    }
)


@dataclass(frozen=True)
class Image:
    """The program of one board with one bridge."""

    board: Board
    bridge: str

    @property
    def name(self) -> str:
        return f"{self.board.name}-{self.bridge}"

    @property
    def hex_path(self) -> Path:
        """Its Intel HEX file. Raises ConfigError where this installation lacks it."""
        return self._file("hex")

    @property
    def bin_path(self) -> Path:
        """Its bytes as they lie in flash. Raises ConfigError where this installation lacks it."""
        return self._file("bin")

    def _file(self, ending: str) -> Path:
        for folder in (_PACKAGE / "images", _PACKAGE.parent.parent / "firmware" / "images"):
            path = folder / f"{self.name}.{ending}"
            if path.is_file():
                return path
        raise ConfigError(f"this installation of fiohost lacks the firmware {self.name}.{ending}: install it anew")


def find_image(board: str, bridge: str | None = None) -> Image:
    """By board, or board and bridge in one word (``uno-l298n``). Raises ConfigError with the nearest known name."""
    name, _, tail = board.partition("-")
    if name not in BOARDS:
        raise ConfigError(f"there is no firmware for a board {board!r}; {nearest(board, BOARDS)}")
    chosen = bridge or tail or DEFAULT_BRIDGE
    if chosen not in BRIDGES:
        raise ConfigError(f"there is no firmware for a bridge {chosen!r}; {nearest(chosen, BRIDGES)}")
    if bridge and tail and bridge != tail:
        raise ConfigError(f"{board!r} names one bridge and --bridge {bridge!r} another")
    return Image(BOARDS[name], chosen)


def images() -> list[Image]:
    """All that ship."""
    return [Image(board, bridge) for board in BOARDS.values() for bridge in BRIDGES]
