"""The guest's side: plugs the gadget in, serves the board on it, runs fiohost against it, and prints a table.

Run by ``boot.py`` as root in the guest. Exit code 0 where every step was as it must be.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # an installed fiohost or this checkout: the same text

from plug import wait_for_nodes

from firmware_model import gadget


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--run", metavar="COMMAND")
    parser.add_argument("--board", metavar="OPTIONS")
    parser.add_argument("--only", metavar="WORDS", default="")
    asked = parser.parse_args()
    controller = gadget.up()
    wait_for_nodes()
    kernel = Path("/proc/version").read_text().partition(" (")[0]
    print(f"guest: {kernel}, gadget on {controller}", flush=True)
    if asked.run is not None:
        return _run(asked.run, asked.board)
    import steps

    return steps.all_of_them(asked.only)


def _run(command: str, board: str | None) -> int:
    served = None
    if board is not None:
        words = [sys.executable, "-m", "firmware_model", *board.split()]
        served = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert served.stdout is not None
        print("board:", served.stdout.readline().strip(), flush=True)
    try:
        return subprocess.call(command, shell=True)
    finally:
        if served is not None:
            served.terminate()
            print("board:", served.communicate(timeout=60)[0].strip())


if __name__ == "__main__":
    sys.exit(main())
