"""A log that grows, row by row as its writer puts them down: whole lines only, and when it has ended."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from fiohost.bench.head import read_head
from fiohost.bench.integrity import PREFIX
from fiohost.bench.log import Log
from fiohost.errors import LogError
from fiohost.files import open_input

MOST_HEAD_BYTES = 2_000_000
READ_BYTES = 4_000_000
MOST_BYTES = 10**12  # of what is followed, a piece at a time: years
POLL_S = 0.2


class GrowingLog:
    """The rows of a log file as they come. ``ended`` is true once its writer has put its last line."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.ended = False
        self.cut_off = False
        self._rest = b""
        self._head = ""
        self._columns = 0
        self._time_column = 0
        self._file = open_input(path, MOST_BYTES, "the log", LogError)

    def close(self) -> None:
        self._file.close()

    def lines(self) -> list[tuple[float, str]]:
        """What came since the last call: time in s and text of each whole row. Raises LogError where it is no log."""
        if os.fstat(self._file.fileno()).st_size < self._file.tell():
            self.cut_off = True
            return []
        data = self._rest + self._file.read(READ_BYTES)
        if not self._head:
            data = self._take_head(data)
        whole, _, self._rest = data.rpartition(b"\n")
        found: list[tuple[float, str]] = []
        if not self._head or not whole:
            self._rest = data
            if len(data) > MOST_HEAD_BYTES:
                raise LogError(f"{self.path} is not a log: {len(data)} bytes without an end of a line")
            return found
        for line in whole.decode("utf-8", errors="replace").split("\n"):
            if line.startswith(PREFIX):
                self.ended = True
            cells = line.split(",")
            if len(cells) != self._columns or line.startswith("#"):
                continue
            try:
                time_s = float(cells[self._time_column])
            except ValueError:
                continue  # the reader of logs says so of a whole file; here it is one row less
            if math.isfinite(time_s):
                found.append((time_s, line))
        return found

    def _take_head(self, data: bytes) -> bytes:
        """What follows the head, once that is whole."""
        text = data.decode("utf-8-sig", errors="replace")
        for end, line in _ends(text):
            if line and not line.startswith("#"):
                _, names, start, _ = read_head(text[:end], self.path)
                if "time_s" not in names:
                    raise LogError(f"{self.path} has no column 'time_s': fiohost import makes a log of any table")
                self._head, self._columns = text[:start], len(names)
                self._time_column = names.index("time_s")
                return text[start:].encode()
        if len(data) > MOST_HEAD_BYTES:
            raise LogError(f"{self.path} is not a log: no column names in its first {MOST_HEAD_BYTES} bytes")
        return data

    def log(self, lines: list[str]) -> Log:
        """A log of some of the rows, with the head of the whole."""
        return Log.parse(self._head + "\n".join(lines) + "\n", path=self.path)


def _ends(text: str) -> Iterator[tuple[int, str]]:
    position = 0
    while (end := text.find("\n", position)) >= 0:
        yield end + 1, text[position:end].strip()
        position = end + 1


def following(
    log: GrowingLog, *, idle_s: float, follow: bool = True, now: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] = time.sleep,
) -> Iterator[list[tuple[float, str]]]:  # fmt: skip
    """Rows as they come, an empty list where none did, until the log has ended or nothing came for ``idle_s``."""
    last = now()
    while True:
        rows = log.lines()
        if rows:
            last = now()
        yield rows
        if log.ended or log.cut_off or (not rows and (not follow or now() - last >= idle_s)):
            return
        if not rows:
            wait(POLL_S)
