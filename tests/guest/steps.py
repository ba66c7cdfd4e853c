"""What is shown in the guest, step by step; each is a row of the table."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from contextlib import suppress

from children import Child, StepFailed
from ends import HIDRAW, LIBUSB, SERIAL, WORK, Line, board
from mishaps import WATCHDOG_S, fresh, guarded, killed, reconnected, udev_rules, unplugged
from ordinary import CLOSED_LOOP, EXPERIMENT, closed_loop, deadband, doctor, manual
from plug import replug

Step = Callable[[Line], tuple[Child | None, str]]

ORDINARY: tuple[tuple[str, Step], ...] = (
    ("doctor", doctor),
    ("manual 40 %, 3 s", manual),
    ("deadband", deadband),
    ("run, closed loop, 10 s", closed_loop),
    ("unplugged in mid-run", unplugged),
    ("unplugged, --reconnect", reconnected),
)
WATCHDOG = ("--watchdog", f"{WATCHDOG_S:g}")
# each board, by its line and options, and what is done with it
BOARDS: tuple[tuple[Line, tuple[str, ...], tuple[tuple[str, Step], ...]], ...] = (
    (HIDRAW, (), (("udev rules", udev_rules), *ORDINARY)),
    (LIBUSB, (), ORDINARY),
    (LIBUSB, ("--layout", LIBUSB.framed_layout), (("opened anew, held up", fresh),)),
    (HIDRAW, ("--layout", HIDRAW.framed_layout, *WATCHDOG), (("kill -9, watchdog", killed),)),
    (HIDRAW, ("--layout", HIDRAW.framed_layout), (("kill -9, guardian", guarded),)),
    (SERIAL, (), ORDINARY),
    (SERIAL, ("--layout", SERIAL.framed_layout, *WATCHDOG), (("kill -9, watchdog", killed),)),
    (SERIAL, ("--layout", SERIAL.framed_layout), (("kill -9, guardian", guarded),)),
)
EVERYTHING = (
    *("fiohost.bench.connect", "fiohost.bench.deadband", "fiohost.bench.doctor", "fiohost.report.deadband"),
    *("fiohost.cli.main", "fiohost.cli.deadband", "fiohost.cli.drive", "fiohost.cli.hardware", "fiohost.cli.run"),
    *("fiohost.transport.discovery", "fiohost.transport.hid", "fiohost.transport.serial", "fiohost.panel.keys"),
)


def all_of_them(only: str = "") -> int:
    """Every step whose line and name have *only* in them. 1 where one failed, or where there was none."""
    WORK.mkdir(parents=True, exist_ok=True)
    CLOSED_LOOP.write_text(EXPERIMENT)
    _import_everything()
    table = Table()
    for line, options, steps in BOARDS:
        wanted = [(what, run) for what, run in steps if only in f"{line.name} {what}"]
        if wanted:
            with board(line, *options):
                for what, run in wanted:
                    table.step(line, what, run)
    print(f"guest: {table.failed} of {table.done} steps failed", flush=True)
    return 1 if table.failed or not table.done else 0


class Table:
    """Runs steps and prints a row for each. ``done`` and ``failed`` count them."""

    def __init__(self) -> None:
        self.done = self.failed = 0
        print(f"{'line':8s} {'step':28s} {'exit':>5s} {'time':>7s}  result", flush=True)

    def step(self, line: Line, what: str, run: Step) -> None:
        self.done += 1
        began_s, code = time.monotonic(), "-"
        try:
            child, note = run(line)
            code = "-" if child is None else str(child.code)
        except Exception as exc:
            self.failed += 1
            note = f"FAILED: {exc}" if isinstance(exc, StepFailed) else f"FAILED: {type(exc).__name__}: {exc}"
            Child.end_all("fiohost")
            with suppress(Exception):
                replug()
        took_s = time.monotonic() - began_s
        print(f"{line.name:8s} {what:28s} {code:>5s} {took_s:6.1f}s  {note}", flush=True)


def _import_everything() -> None:
    """Once, here: each child is a copy of this process."""
    for name in EVERYTHING:
        importlib.import_module(name)
    from matplotlib import pyplot

    from firmware_model import Board, load_plant

    pyplot.figure().savefig(WORK / "first.svg")  # fonts and the like
    for layout in ("assumed", "framed"):
        Board(load_plant("default"), layout=layout).step(None)
    print(f"guest: everything imported, {time.process_time():.1f} s of its CPU", flush=True)
