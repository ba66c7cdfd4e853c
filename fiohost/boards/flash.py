"""Firmware onto a board, with the tools that people have for it: avrdude, st-flash, stm32flash.

Nothing is put together from text by a shell: a program and its arguments, shown before they run.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable, Sequence

from fiohost.boards.images import Image
from fiohost.errors import ConfigError, FiohostError

FLASH_START = "0x08000000"
OLD_NANO_BAUD = 57_600
INSTALL = {
    "avrdude": "avrdude (Debian: apt-get install avrdude)",
    "st-flash": "st-flash (Debian: apt-get install stlink-tools)",
    "stm32flash": "stm32flash (Debian: apt-get install stm32flash)",
}

Run = Callable[[Sequence[str]], int]
Which = Callable[[str], str | None]


def command_of(
    image: Image, port: str | None, *, old_bootloader: bool = False, which: Which = shutil.which
) -> list[str]:
    """The program and its arguments that flash an image. Raises ConfigError, naming what to install or to give.

    A Blue Pill goes through its ST-Link without a port, through its serial bootloader with one.
    """
    if image.board.name == "uno":
        if port is None:
            raise ConfigError("an Uno is flashed through its serial port: give --port, as 'fiohost devices' lists it")
        speed = ["-b", str(OLD_NANO_BAUD)] if old_bootloader else []
        what = f"flash:w:{image.hex_path}:i"
        return [_tool("avrdude", which), "-p", "m328p", "-c", "arduino", *speed, "-P", port, "-U", what]
    if old_bootloader:
        raise ConfigError("--old-bootloader is of Arduino Nanos only")
    if port is None:
        return [_tool("st-flash", which), "--reset", "write", str(image.bin_path), FLASH_START]
    return [_tool("stm32flash", which), "-w", str(image.hex_path), "-v", "-g", FLASH_START, port]


def _tool(name: str, which: Which) -> str:
    path = which(name)
    if path is None:
        raise ConfigError(f"flashing this board needs {INSTALL[name]}; it is not installed here")
    return path


def flash(command: Sequence[str], run: Run | None = None) -> None:
    """Run it, its words going where ours go. Raises FiohostError where it fails."""
    try:
        code = (run or (lambda words: subprocess.run(words).returncode))(command)
    except OSError as exc:
        raise FiohostError(f"{command[0]} cannot be run: {exc.strerror}") from exc
    if code:
        raise FiohostError(
            f"{command[0].rpartition('/')[2]} failed with exit code {code}: is the port right and free, the board "
            "plugged in (a Blue Pill's serial bootloader: BOOT0 at 1, then reset), an old Nano --old-bootloader?"
        )
