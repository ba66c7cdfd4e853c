"""What fiohost adds to a line: its loop against a bare loop of the library's own calls, in turn, in one run.

    python benchmarks/line.py                                     pyserial, a pty, the board in a process of its own
    python benchmarks/line.py --hid --node /dev/hidg0             hidapi; the other end of the cable is here too
    python benchmarks/line.py --hid /dev/hidraw0                  hidapi, a real board
    python benchmarks/line.py --serial /dev/ttyACM0               pyserial, a real board

The motor stays braked. The bare loop reads a report, takes the count out of it and writes the next command; fiohost
does what it does in every run, its log included. Where the board is ours, the round trip is the board's: from a
report's leaving to its answer's arrival, and a deadline is missed where no answer came before the next report. Of a
real board the host sees its own part alone: from the report in the program's hands to the answer handed over; a
deadline is missed where a task step passes without an answer. CPU is all of the process's, system calls included.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import platform
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))

from line_figures import BARE, FIOHOST, Block, count_missed, figures, histogram, ratios, share_out

from fiohost.bench.connect import connect
from fiohost.bench.program import Answer
from fiohost.transport.timed import TimedTransport
from fiohost.wire.messages import BRAKE_COMMAND

BLOCK_S = 1.0
READ_S = 1.0  # a busy machine may hold up the board's process; that is no silence
REPORT_BYTES = 64
HEADER, PACKET_BYTES = b"\x7e\x7e", 7


# ---- the two loops ---------------------------------------------------------------------------------------------------


def bare_serial(port_name: str, seconds: float) -> Block:
    """A bare loop of pyserial calls."""
    import serial

    packet = HEADER + struct.pack("<fBB", 0.0, 1, 1) + b"\x03\x03"
    with serial.Serial(port_name, 115200, timeout=READ_S) as port:
        port.reset_input_buffer()
        while port.read(1) != b"\x03" or port.read(1) != b"\x03":  # to the end of a packet
            pass

        def turn() -> int:
            data = port.read(PACKET_BYTES)
            now_ns = time.monotonic_ns()
            struct.unpack_from("<BH", data, 2)
            port.write(packet)
            return now_ns

        return _timed(turn, seconds)


def bare_hid(which: str, seconds: float) -> Block:
    """A bare loop of hidapi calls."""
    try:
        import hidraw as hid
    except ImportError:
        import hid
    device = hid.device()
    if which.startswith("/"):
        device.open_path(which.encode())
    else:
        device.open(*(int(part, 16) for part in which.split(":")[:2]))
    report = b"\0" + struct.pack("<fBB58x", 0.0, 1, 1)

    def turn() -> int:
        data = device.read(REPORT_BYTES, round(1e3 * READ_S))
        now_ns = time.monotonic_ns()
        struct.unpack_from("<BH", bytes(data))
        device.write(report)
        return now_ns

    try:
        while device.read(REPORT_BYTES, 1):  # what waited there
            pass
        return _timed(turn, seconds)
    finally:
        device.close()


def _timed(turn: Any, seconds: float) -> Block:
    block = Block(BARE)
    turn()
    block.begin_ns, cpu_s = time.monotonic_ns(), time.process_time()
    end_ns = block.begin_ns + round(1e9 * seconds)
    while True:
        read_ns = turn()
        now_ns = time.monotonic_ns()
        block.read_ns.append(read_ns)
        block.host_ns.append(now_ns - read_ns)
        if now_ns >= end_ns:
            break
    block.end_ns, block.cpu_s, block.ticks = now_ns, time.process_time() - cpu_s, len(block.read_ns)
    return block


class _Braked:
    """Asked by fiohost's loop: brakes for some seconds and notes when it began and ended."""

    def __init__(self, block: Block, seconds: float, timed: TimedTransport | None) -> None:
        self._block, self._seconds, self._timed = block, seconds, timed
        self._answer: Answer = (BRAKE_COMMAND, None)
        self._first = (0, 0)
        self._cpu_s = 0.0
        self._asked = 0

    def step(self, k: int, angle_deg: float) -> Answer | None:
        now_ns, block, timed = time.monotonic_ns(), self._block, self._timed
        self._asked += 1
        if self._asked == 2:
            block.begin_ns, self._cpu_s = now_ns, time.process_time()
            self._first = (len(timed.received_s) - 1, len(timed.answered_s)) if timed else (0, 0)
        elif block.begin_ns and now_ns >= block.begin_ns + 1e9 * self._seconds:
            block.end_ns, block.cpu_s, block.ticks = now_ns, time.process_time() - self._cpu_s, self._asked - 2
            if timed:
                block.read_ns = [round(1e9 * s) for s in timed.received_s[self._first[0] :]]
                block.host_ns = [round(1e9 * s) for s in timed.answered_s[self._first[1] :]]
            return None
        return self._answer


def fiohost_block(target: str, seconds: float, log: Path, *, seen_by_host: bool) -> Block:
    """fiohost as in every run. *seen_by_host*: its calls are timed too, which costs it some microseconds."""
    block = Block(FIOHOST)
    with connect(target, guards={"silence_s": READ_S}) as bench:
        timed = TimedTransport(bench.transport, time.monotonic) if seen_by_host else None
        if timed is not None:
            bench.transport = timed
        bench.live(_Braked(block, seconds, timed), log)
        if timed is not None:
            bench.transport = timed.inner
    return block


# ---- the other end ---------------------------------------------------------------------------------------------------


class OwnBoard:
    """The board of :mod:`stopwatch_board`, in a process of its own."""

    def __init__(self, link: str, node: str | None) -> None:
        command = [sys.executable, str(Path(__file__).parent / "stopwatch_board.py"), link]
        command += ["--node", node] if node else []
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        self.where = self._process.stdout.readline().strip()

    def close(self) -> dict[str, list[int | None]]:
        self._process.send_signal(signal.SIGTERM)
        times: dict[str, list[int | None]] = json.loads(self._process.communicate(timeout=60)[0])
        return times


@contextmanager
def link_name() -> Iterator[str]:
    with tempfile.TemporaryDirectory() as folder:
        yield str(Path(folder) / "board")


def load() -> list[float]:
    return [round(x, 2) for x in os.getloadavg()]


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    line = parser.add_mutually_exclusive_group()
    line.add_argument("--hid", nargs="?", const="0483:5750", metavar="PATH|VID:PID", help="a HID device (0483:5750)")
    line.add_argument("--serial", metavar="PORT", help="a serial port")
    parser.add_argument("--node", help="the other end of the cable, to serve the board on: /dev/hidg0, /dev/ttyGS0")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each loop (60)")
    parser.add_argument("--json", metavar="FILE|-", help="write the figures as JSON")
    options = parser.parse_args()
    if not 1.0 <= options.seconds <= 3600.0:
        parser.error(f"--seconds {options.seconds:g} is not within 1 to 3600")
    return options


def measure(asked: argparse.Namespace) -> tuple[list[Block], str]:
    """All blocks, and which of their times is the round trip."""
    blocks: list[Block] = []
    with link_name() as link:
        board = OwnBoard(link, asked.node) if asked.node or not (asked.hid or asked.serial) else None
        key = "board_ns" if board else "host_ns"
        port = asked.serial or link
        target = f"hid:{asked.hid}" if asked.hid else f"serial:{port}"
        pairs = max(1, round(asked.seconds / BLOCK_S))
        seconds = asked.seconds / pairs
        try:
            if asked.node:
                time.sleep(1.0)  # for the host's side of the cable
            for _ in range(pairs):
                blocks.append(bare_hid(asked.hid, seconds) if asked.hid else bare_serial(port, seconds))
                blocks.append(fiohost_block(target, seconds, Path(link + ".csv"), seen_by_host=board is None))
        finally:
            times = board.close() if board else {}
    if board:
        share_out(blocks, times)
    else:
        count_missed(blocks)
    return blocks, key


def main() -> None:
    asked = parse_arguments()
    logging.getLogger("fiohost").setLevel(logging.ERROR)  # of a board without a watchdog it warns at every opening
    before = load()
    blocks, key = measure(asked)
    found = {loop: figures(blocks, loop, key) for loop in (BARE, FIOHOST)}
    result = {
        "schema": "fiohost.line/1",
        "line": f"hid:{asked.hid}" if asked.hid else f"serial:{asked.serial or 'pty'}",
        "round_trip": "from the board's report to the answer's arrival" if key == "board_ns" else "the host's own part",
        **found,
        "round_trip_ratio": ratios(blocks, key),
        "cpu_ratio": round(found[FIOHOST]["cpu_us_per_tick"] / found[BARE]["cpu_us_per_tick"], 2),
        "missed_beyond_bare": found[FIOHOST]["missed_deadlines"] - found[BARE]["missed_deadlines"],
        "load_before_after": [before, load()],
        "machine": f"{os.cpu_count()} x {platform.machine()}, {platform.system()} {platform.release()}",
        "python": platform.python_version(),
    }
    if asked.json == "-":
        print(json.dumps(result, indent=2))
        return
    if asked.json:
        Path(asked.json).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(f"{result['line']}: {result['round_trip']}; load {before[0]} before, {load()[0]} after")
    for loop in (BARE, FIOHOST):
        one = found[loop]
        spread = "  ".join(f"{name} {value:7.1f}" for name, value in one["round_trip_us"].items())
        print(f"{loop:<8s} {spread} us; CPU {one['cpu_us_per_tick']:6.1f} us a tick; "
              f"{one['missed_deadlines']} of {one['ticks']} deadlines missed")  # fmt: skip
    print(histogram(blocks, key))
    pairs = result["round_trip_ratio"]
    print(f"round trip {pairs['median_of_pairs']:.3f} times the bare one (pairs {min(pairs['pairs']):.3f} to "
          f"{max(pairs['pairs']):.3f}), CPU {result['cpu_ratio']:.2f} times")  # fmt: skip


if __name__ == "__main__":
    main()
