"""How long a motor runs on after its host has died, hung or been stopped: from the last driving command to the brake.

    python benchmarks/guardian.py [--times N]

The board is a pty; the times are on its own clock, one step every 5 ms. Each row is one way to lose the host.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]

from lines import BRAKE, PtyBoard  # noqa: E402

DRIVES = "from fiohost.cli.main import main; main()"
IN_STEP = (
    "import ctypes, os, time\nfrom fiohost.bench.program import Hold\nstep = Hold.step\n"
    "def late(self, k, angle):\n    if k >= 100:\n        {}\n    return step(self, k, angle)\n"
    "Hold.step = late\n" + DRIVES
)
WAYS: dict[str, tuple[str, int]] = {
    "kill -9": (DRIVES, signal.SIGKILL),
    "SIGSEGV": (DRIVES, signal.SIGSEGV),
    "SIGABRT": (DRIVES, signal.SIGABRT),
    "SIGSTOP": (DRIVES, signal.SIGSTOP),
    "os._exit in a controller": (IN_STEP.format("os._exit(7)"), 0),
    "a controller that hangs in Python": (IN_STEP.format("while True: pass"), 0),
    "a controller that hangs in C": (IN_STEP.format("ctypes.PyDLL(None).pause()"), 0),
}


class Stamped(list):  # type: ignore[type-arg]
    """Commands as the board takes them, each with the time."""

    def __init__(self) -> None:
        super().__init__()
        self.at_s: list[float] = []

    def append(self, command: object) -> None:
        self.at_s.append(time.monotonic())
        super().append(command)


def once(code: str, number: int) -> float | None:
    """Seconds from the last driving command to the brake; None where none came within 10 s."""
    with PtyBoard() as board, tempfile.TemporaryDirectory() as folder:
        board.commands = taken = Stamped()
        command = [sys.executable, "-c", code, "manual", "--pwm", "40", "--target", f"serial:{board.target}"]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        host = subprocess.Popen(
            command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            if number:
                while sum(c.compare > 0 for c in list(taken)) < 60:
                    time.sleep(0.01)
                host.send_signal(number)
            began_s, brake = time.monotonic(), None
            while brake is None and time.monotonic() - began_s < 10.0:
                time.sleep(0.02)
                seen = list(taken)
                driven = [i for i, c in enumerate(seen) if c.compare > 0]
                if driven and len(seen) > driven[-1] + 1 and tuple(seen[-1]) == BRAKE:
                    brake = taken.at_s[driven[-1] + 1] - taken.at_s[driven[-1]]
        finally:
            host.kill()
            host.wait()
    return brake


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--times", type=int, default=10, metavar="N")
    times = parser.parse_args().times
    print("| the host | braked | median | longest |\n|---|---|---|---|")
    for name, (code, number) in WAYS.items():
        found = [once(code, number) for _ in range(times)]
        braked_ms = [1e3 * seconds for seconds in found if seconds is not None]
        figures = f"{statistics.median(braked_ms):.0f} ms | {max(braked_ms):.0f} ms" if braked_ms else "- | -"
        print(f"| {name} | {len(braked_ms)} of {times} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
