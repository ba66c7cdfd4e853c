"""The two ends of a line in the guest: the served board, the host's command, and what an onlooker sees of the shaft."""

from __future__ import annotations

import json
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from children import Child, StepFailed

from firmware_model.__main__ import main as serve_board

COUNTS = 720
JIFFY_S = 0.004  # of Debian's kernel
WORK = Path("/run/guest")  # in the guest's memory


@dataclass(frozen=True)
class Line:
    """One way from host to board. ``target`` and ``framed`` are fiohost's, of the plain and of the framed layout."""

    name: str
    device: str  # the board's end
    node: str  # the host's end
    target: str
    framed: str
    framed_layout: str


HIDRAW = Line("hidraw", "/dev/hidg0", "/dev/hidraw0", "hid", "hid-framed", "framed-hid")
LIBUSB = Line("libusb", "/dev/hidg0", "", "hid", "hid-framed", "framed-hid")
SERIAL = Line("ttyACM", "/dev/ttyGS0", "/dev/ttyACM0", "serial:/dev/ttyACM0", "serial-framed:/dev/ttyACM0", "framed")


@contextmanager
def board(line: Line, *options: str) -> Iterator[Child]:
    """The simulated board in real time at its end of the line; afterwards it says how well it kept its deadlines."""
    served = Child("board", serve_board, ["--device", line.device, *options])
    try:
        served.wait_line("Ctrl-C ends")
        yield served
    finally:
        served.kill(15)
        served.wait()
        print(f"  (board on {line.device}: {served.said().splitlines()[-1]}; CPU {served.cpu_s:.1f} s)", flush=True)


def fiohost(line: Line | None, *arguments: str, framed: bool = False) -> Child:
    """The command ``fiohost``, on a line with the target at the end of its arguments."""

    def run(words: Sequence[str]) -> None:
        if line is LIBUSB:
            sys.modules["hidraw"] = None  # type: ignore[assignment]  # as where hidapi has no such module
        from fiohost.cli.main import main

        main(list(words))

    target = [] if line is None else ["--target", line.framed if framed else line.target]
    over = [] if line is None else ["--force"]  # steps share their files
    if line is not None and arguments[0] in ("manual", "run", "deadband", "doctor"):
        # An emulated computer beside other work is late more often.
        over += ["--guard", "late_pct=50"]
    return Child("fiohost", run, [*arguments, *over, *target])


@dataclass(frozen=True)
class Record:
    """A log as it was written: its head, and its rows as numbers by column."""

    head: dict[str, str]
    rows: list[dict[str, float]]


def read_log(path: Path) -> Record:
    """Raises StepFailed where a row is not whole or ticks go back: a log that a run left must be complete."""
    text = path.read_text()
    if not text.endswith("\n"):
        raise StepFailed(f"the log {path.name} ends in mid-line")
    head: dict[str, str] = {}
    columns: list[str] = []
    rows: list[dict[str, float]] = []
    for text_line in text.splitlines():
        if text_line.startswith("# "):
            key, _, value = text_line[2:].partition(": ")
            head[key] = value.strip()
        elif not columns:
            columns = text_line.split(",")
        else:
            cells = text_line.split(",")
            if len(cells) != len(columns):
                raise StepFailed(f"the log {path.name} has a row of {len(cells)} cells: {text_line!r}")
            rows.append({key: float(cell) for key, cell in zip(columns, cells, strict=True) if cell})
    times = [row["time_s"] for row in rows]
    if times != sorted(set(times)):
        raise StepFailed(f"the times in {path.name} do not rise")
    return Record(head, rows)


def row_count(path: Path) -> int:
    """Rows of a log that is being written."""
    lines = path.read_bytes().splitlines() if path.exists() else []
    return sum(1 for one in lines if one[:1].isdigit())


def first_gone_s(trace: Path) -> float:
    """When, on the system's clock, the host had found the board gone: at the latest, by the trace's last line, whose
    time the file carries in jiffies.
    """
    events = [json.loads(one) for one in trace.read_text().splitlines()]
    gone = [float(one["t"]) for one in events if one.get("dir") == "gone"]
    if not gone:
        raise StepFailed(f"the trace {trace.name} does not say 'gone'")
    return trace.stat().st_mtime + JIFFY_S - (float(events[-1]["t"]) - gone[0])


def watch(line: Line, pos_at: Callable[[bytes], int | None], seconds: float) -> list[tuple[float, int]]:
    """(time, POS) of each report that comes within some seconds, read beside or after the host at the same node."""
    seen: list[tuple[float, int]] = []
    fd = os.open(line.node, os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        if os.isatty(fd):
            tty.setraw(fd, termios.TCSANOW)
        end_s, rest = time.monotonic() + seconds, b""
        while (left_s := end_s - time.monotonic()) > 0.0:
            if not select.select([fd], [], [], left_s)[0]:
                break
            rest += os.read(fd, 64)
            now_s = time.monotonic()
            while len(rest) >= 13:
                pos = pos_at(rest[:13])
                if pos is not None:
                    seen.append((now_s, pos))
                rest = rest[1:] if pos is None else rest[13:]
            if not os.isatty(fd):
                rest = b""
    finally:
        os.close(fd)
    return seen


def framed_pos(report: bytes) -> int | None:
    """POS of a framed report, A5 5A first, counted as whole where it is one that can be."""
    pos = int.from_bytes(report[9:11], "little")
    return pos if report[:2] == b"\xa5\x5a" and report[8] < 2 and pos < COUNTS else None


def counts_between(first: int, last: int) -> int:
    """The short way round."""
    return abs((last - first + COUNTS // 2) % COUNTS - COUNTS // 2)
