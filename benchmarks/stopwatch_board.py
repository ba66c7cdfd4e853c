"""The simulated board in a process of its own, noting when each report left it and when the answer arrived.

    python benchmarks/stopwatch_board.py LINK [--node /dev/hidg0]

Serves a pty named LINK, or the device side of a USB cable. On SIGTERM it prints one JSON object: ``sent_ns`` (the
system's monotonic clock) of every report, and ``took_ns`` until the first command after it, null where none came before
the next report. The clock is that of all processes of one kernel.
"""

from __future__ import annotations

import argparse
import json
import select
import signal
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from firmware_model.board import STEP_S, Board
from firmware_model.lines.node import NodeLine, PtyLine
from firmware_model.plants import load_plant
from firmware_model.serve import serve

WAIT_S = STEP_S - 0.0005  # for an answer; what comes later is seen at the next step


class Stopwatch:
    """A line that waits for the answer to each report, inside the time that the board's task has left."""

    def __init__(self, line: NodeLine) -> None:
        self._line = line
        self.stream, self.where = line.stream, line.where
        self._held: list[bytes] = []
        self.sent_ns: list[int] = []
        self.took_ns: list[int | None] = []

    def receive(self) -> list[bytes]:
        came = self._line.receive()
        if came:
            self._arrived(time.monotonic_ns())
        held, self._held = self._held, []
        return held + came

    def send(self, report: bytes) -> None:
        self.sent_ns.append(time.monotonic_ns())
        self.took_ns.append(None)
        self._line.send(report)
        node = self._line._fd
        if node >= 0 and select.select([node], [], [], WAIT_S)[0]:  # below 0: no cable
            self._arrived(time.monotonic_ns())
            self._held = self._line.receive()

    def _arrived(self, now_ns: int) -> None:
        if self.took_ns and self.took_ns[-1] is None:
            self.took_ns[-1] = now_ns - self.sent_ns[-1]

    def close(self) -> None:
        self._line.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("link", nargs="?", help="a name for the pty")
    parser.add_argument("--node", help="/dev/hidg0 or /dev/ttyGS0 in place of a pty")
    asked = parser.parse_args()
    is_hid = asked.node is not None and "hidg" in asked.node
    layout = "assumed" if is_hid else "documented"
    board = Board(load_plant("default"), layout=layout)
    board.step(None)  # compiled before anybody waits for it
    line = Stopwatch(NodeLine(asked.node, stream=not is_hid) if asked.node else PtyLine(asked.link))
    stopped: list[int] = []
    for name in ("SIGINT", "SIGTERM"):
        signal.signal(getattr(signal, name), lambda signum, frame: stopped.append(signum))
    print(line.where, flush=True)
    serve(board.step, line, layout, stop=lambda: bool(stopped))
    line.close()
    print(json.dumps({"sent_ns": line.sent_ns, "took_ns": line.took_ns}))


if __name__ == "__main__":
    main()
