"""``fiohost firmware``: the programs that ship for boards, and how they get onto one."""

from __future__ import annotations

import shlex
import sys

import click

from fiohost.boards.images import BRIDGES, DEFAULT_BRIDGE
from fiohost.cli.output import json_option, output_for

BRIDGE_HELP = f"The bridge that is wired to it: {', '.join(BRIDGES)} ({DEFAULT_BRIDGE})."
bridge_option = click.option("--bridge", metavar="B", help=BRIDGE_HELP)


@click.group(epilog="Example: fiohost firmware flash uno --port /dev/ttyACM0")
def firmware() -> None:
    """Programs that make a cheap board with a bridge a control bench: list them, find them, flash them.

    None of them has met a real board yet: they are proven in emulators. See docs/firmware.md for the wiring.
    """


@firmware.command("list")
@json_option
def list_(json_to: str | None) -> None:
    """List boards and bridges that there is firmware for.

    \b
    Example:
      fiohost firmware list
    """
    from fiohost.boards.images import BOARDS, images
    from fiohost.transport.profile import TargetProfile

    out = output_for(json_to)
    rows = []
    for board in BOARDS.values():
        profile = TargetProfile.load(board.name)
        out(f"{board.name}: {board.title}, {board.chip}; {profile.duty_steps} duty steps, {profile.baud} Bd")
        for image in (one for one in images() if one.board == board):
            size = image.bin_path.stat().st_size
            out(f"    --bridge {image.bridge:8s} {size:5d} bytes  {BRIDGES[image.bridge]}")
            rows.append(
                {
                    "board": board.name,
                    "bridge": image.bridge,
                    "chip": board.chip,
                    "bytes": size,
                    "duty_steps": profile.duty_steps,
                    "baud": profile.baud,
                    "watchdog_s": profile.watchdog_s,
                    "hex": str(image.hex_path),
                    "bin": str(image.bin_path),
                }
            )
    out("none of them has met a real board yet: docs/firmware.md says what was shown, and how to wire it")
    out.json({"schema": "fiohost.firmware/1", "images": rows})


@firmware.command()
@click.argument("board", metavar="BOARD")
@bridge_option
@click.option("--bin", "as_bin", is_flag=True, help="The .bin file in the place of the .hex.")
def path(board: str, bridge: str | None, as_bin: bool) -> None:
    """Print the file of a board's program, for tools of your own.

    \b
    Example:
      fiohost firmware path uno
      avrdude -p m328p -c arduino -P /dev/ttyACM0 -U flash:w:$(fiohost firmware path uno)
    """
    from fiohost.boards.images import find_image

    image = find_image(board, bridge)
    click.echo(image.bin_path if as_bin else image.hex_path)


@firmware.command()
@click.argument("board", metavar="BOARD")
@click.option("--port", metavar="P", help="Serial port; a Blue Pill without one goes through its ST-Link.")
@bridge_option
@click.option("--old-bootloader", is_flag=True, help="An Arduino Nano with the old bootloader (57600 Bd).")
@click.option("--dry-run", is_flag=True, help="Show what would be run, and run nothing.")
def flash(board: str, port: str | None, bridge: str | None, old_bootloader: bool, dry_run: bool) -> None:
    """Put a board's program onto it, with avrdude (Uno, Nano), st-flash or stm32flash (Blue Pill).

    Take the motor's supply off before: while a board is flashed only its pull-downs keep the bridge off.

    \b
    Example:
      fiohost firmware flash uno --port /dev/ttyACM0
      fiohost firmware flash uno --port COM3 --bridge l298n
      fiohost firmware flash bluepill
      fiohost firmware flash bluepill --port /dev/ttyUSB0
    """
    from fiohost.boards import flash as flashing
    from fiohost.boards.images import find_image

    image = find_image(board, bridge)
    command = flashing.command_of(image, port, old_bootloader=old_bootloader)
    click.echo(shlex.join(command))
    if dry_run:
        return
    sys.stdout.flush()
    flashing.flash(command)
    where = "" if port is None else f":{port}"
    click.echo(f"{image.name} is on the board; 'fiohost doctor --target {image.board.name}{where}' asks it who it is")


@firmware.command()
@click.argument("folder", metavar="FOLDER", type=click.Path(file_okay=False))
def sketch(folder: str) -> None:
    """Write the Uno's program as a sketch, FOLDER/fiohost_uno, that the Arduino IDE opens, builds and uploads.

    \b
    Example:
      fiohost firmware sketch ~/Arduino
    """
    from fiohost.boards.sketch import write_sketch

    made = write_sketch(folder)
    click.echo(f"{made}: open it in the Arduino IDE; the bridge is chosen in its tab fio_config.h")
