"""``python -m firmware_model``: the simulated board as a device of its own, in real time, on a real line."""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from types import FrameType

from firmware_model.board import STEP_S, Board
from firmware_model.errors import FirmwareModelError
from firmware_model.faults import FaultyBoard
from firmware_model.formats import NAMES, make_format
from firmware_model.lines import Line
from firmware_model.plants import Plant, load_plant
from firmware_model.serve import Step, serve

EXAMPLES = """examples:
  python -m firmware_model --pty /tmp/board             then: fiohost manual --pwm 40 --target serial:/tmp/board
  python -m firmware_model --device /dev/ttyGS0         on a Raspberry Pi set up as a serial gadget
  python -m firmware_model --device /dev/hidg0          on a Raspberry Pi set up as a HID gadget
  python -m firmware_model --uhid                       a HID device of this computer (Linux, root)
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Serve until a signal comes. Exit code 0, or 1 with one sentence where it cannot be done."""
    asked = _parser().parse_args(arguments)
    stopped: list[int] = []

    def on_signal(signum: int, frame: FrameType | None) -> None:
        stopped.append(signum)

    try:
        plant = _plant(asked)
        layout = asked.layout or ("documented" if _is_stream(asked) else "assumed")
        _step_of(plant, asked, layout)(None)  # compiled before anybody waits for it
        step, line = _step_of(plant, asked, layout), _line(asked, layout)
    except FirmwareModelError as exc:
        print(f"firmware_model: {exc}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    target = line.where if line.where.startswith("hid:") else f"{'serial' if line.stream else 'hid'} at {line.where}"
    guard = f"watchdog {plant.watchdog['timeout_s']:g} s" if plant.watchdog else "no watchdog"
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        signal.signal(getattr(signal, name), on_signal)
    print(f"plant {plant.name}, layout {layout}, {guard}: {target}; Ctrl-C ends", flush=True)
    try:
        kept = serve(step, line, layout, step_s=1e-3 * asked.step_ms, stop=lambda: bool(stopped))
    finally:
        line.close()
    print(kept.describe())
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        "python -m firmware_model", description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawTextHelpFormatter
    )
    line = parser.add_mutually_exclusive_group(required=True)
    line.add_argument("--pty", nargs="?", const="", metavar="LINK", help="a pty; LINK is a name for it that stays")
    line.add_argument("--device", metavar="NODE", help="a gadget's node: /dev/ttyGS0 (serial) or /dev/hidg0 (HID)")
    line.add_argument("--uhid", nargs="?", const="SIMULATED", metavar="SERIAL", help="a HID device through /dev/uhid")
    parser.add_argument("--plant", default="default", metavar="P", help="name of a plant, or its file (default)")
    parser.add_argument("--layout", choices=NAMES, help="reports that it speaks (serial: documented, HID: assumed)")
    parser.add_argument("--watchdog", type=float, metavar="S", help="brake after S seconds without a valid command")
    parser.add_argument("--seed", type=int, metavar="N", help="how the shaft starts, and what faults of the plant do")
    parser.add_argument("--step-ms", type=float, default=1e3 * STEP_S, metavar="MS", help="of the board's task (5)")
    return parser


def _is_stream(asked: argparse.Namespace) -> bool:
    return asked.pty is not None or (asked.device is not None and "hidg" not in asked.device)


def _plant(asked: argparse.Namespace) -> Plant:
    plant = load_plant(asked.plant)
    if not 0.1 <= asked.step_ms <= 1000.0:
        raise FirmwareModelError(f"--step-ms {asked.step_ms:g} is outside 0.1 to 1000 ms")
    if asked.watchdog is not None:
        if not 0.005 <= asked.watchdog <= 60.0:
            raise FirmwareModelError(f"--watchdog {asked.watchdog:g} is outside 0.005 to 60 s")
        plant = replace(plant, watchdog={"timeout_s": asked.watchdog})
    return plant


def _step_of(plant: Plant, asked: argparse.Namespace, layout: str) -> Step:
    board = Board(plant, seed=asked.seed, layout=layout)
    if plant.faults is None:
        return partial(board.step, span_s=1e-3 * asked.step_ms)
    if asked.step_ms != 1e3 * STEP_S:
        raise FirmwareModelError("a plant with faults has a clock of its own: leave --step-ms out")
    return FaultyBoard(board, plant.faults, seed=asked.seed).step


def _line(asked: argparse.Namespace, layout: str) -> Line:
    form = make_format(layout)
    if _is_stream(asked) and not form.start:
        raise FirmwareModelError(f"layout {layout} has no header: on a stream nobody can tell where a report begins")
    if asked.pty is not None:
        from firmware_model.lines.node import PtyLine

        return PtyLine(asked.pty or None)
    if asked.device is not None:
        from firmware_model.lines.node import NodeLine

        return NodeLine(asked.device, stream=_is_stream(asked))
    from firmware_model.lines.uhid import UhidLine

    return UhidLine(form.in_size, form.out_size, asked.uhid)


if __name__ == "__main__":
    sys.exit(main())
