"""Writing a log: every row goes to the operating system as soon as it is known, so that a killed host loses none.

What is only known at the end (how the run ended, tick statistics) has lines of fixed width in the head, written over
when the log is closed; in the log of a killed host they still say ``unfinished``.
"""

from __future__ import annotations

import errno
import io
import os
import re
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from fiohost import files
from fiohost.background import Background
from fiohost.bench.integrity import end_line
from fiohost.errors import FiohostError, LogError

SCHEMA = "fiohost.log/1"
COLUMNS = ("time_s", "duty_pct", "c3", "c4", "pos", "direction", "ref_deg", "angle_deg")
_ENDING_BYTES = 240
_STATISTICS_BYTES = 480  # of a bad line there is much to say
_CLOCK_BYTES = 40
_BEGINS_BYTES = 20
MAX_WAITING = 400  # rows that a disk may be behind: 2 s at 5 ms
CLOSE_LIMIT_S = 5.0
_UNFINISHED = "unfinished (the host did not close this log)"


class LogWriter:
    """Writes one log. A context manager; ``row`` for each tick, ``close(ending)`` or leaving the context ends it.

    ``path=None`` keeps the log in memory (:meth:`text`). *behind*: rows are written by a thread of their own, one by
    one and at once, so that a disk that does not answer does not hold up who writes them. Raises LogError where the
    file cannot be written.
    """

    def __init__(
        self, path: files.Output | None, metadata: Mapping[str, str], *, host_time: bool = False, behind: bool = False
    ) -> None:
        self.path: Path | None = None
        self.rows = 0
        self._whole = 0  # bytes of the head and of whole rows
        self._bench_time_s: float | None = None
        self._begins = ""
        self._host_time = host_time
        self._file: BinaryIO = io.BytesIO()
        if path is not None:
            try:
                self._file, self.path = files.open_log(path, "the log")
            except FiohostError as exc:
                raise LogError(f"{exc}; nothing was driven") from exc
        self.also: Callable[..., None] | None = None  # is given every row too
        self._closed = False
        head = [f"# schema: {SCHEMA}\n"]
        head += [f"# {one_line(k, 60)}: {one_line(v, 500)}\n" for k, v in metadata.items() if v != "" and k != "schema"]
        self._head = "".join(head)
        self._ending_at = len(self._head.encode())
        self._names = ",".join((*COLUMNS, "host_time_s") if host_time else COLUMNS) + "\n"
        self._rows_crc = 0
        try:
            self._write((self._head + self._late_lines(_UNFINISHED, "unknown") + self._names).encode())
        except LogError:
            self._file.close()
            raise
        self._behind = Background(self._write_row, MAX_WAITING, "log") if behind and self.path is not None else None

    def begin(self, bench_time_s: float, at_rest: bool) -> None:
        """Say in the head that the run begins: time since the bench was opened, and whether the shaft stands still.

        Raises LogError.
        """
        self._bench_time_s, self._begins = bench_time_s, "at rest" if at_rest else "moving"
        try:
            self._say(_UNFINISHED, "unknown")
        except OSError as exc:
            raise LogError(f"cannot write the log {self.path}: {exc.strerror}; nothing was driven") from exc

    def row(
        self,
        time_s: float,
        duty_pct: float,
        c3: int,
        c4: int,
        pos: int,
        direction: int,
        ref_deg: float | None = None,
        angle_deg: float | None = None,
        host_time_s: float | None = None,
    ) -> None:
        """Write one tick: the encoder reading of this tick and the command computed from it. Raises LogError."""
        if self.also is not None:
            self.also(time_s, duty_pct, c3, c4, pos, direction, ref_deg, angle_deg, host_time_s)
        ref = "" if ref_deg is None else f"{ref_deg:.9g}"
        angle = "" if angle_deg is None else f"{angle_deg:.12g}"
        line = f"{time_s:.9g},{duty_pct:.9g},{c3},{c4},{pos},{direction},{ref},{angle}"
        if self._host_time:
            line += f",{host_time_s:.6f}" if host_time_s is not None else ","
        data = line.encode() + b"\n"
        behind = self._behind
        if behind is None:
            self._write_row(data)
            return
        if behind.problem is not None:
            raise behind.problem
        if not behind.put(data):
            raise LogError(
                f"cannot write the log {self.path}: the disk has taken nothing for the last {behind.waiting} rows; "
                f"{self.rows} rows are in it"
            )

    def _write_row(self, data: bytes) -> None:
        self._write(data)
        self._rows_crc = zlib.crc32(data, self._rows_crc)
        self.rows += 1

    def close(self, ending: str = "complete", statistics: str = "") -> None:
        """Say in the head how the run ended, make the file durable and close it. Twice is harmless."""
        if self._closed:
            return
        self._closed = True
        behind = self._behind
        if behind is None:
            self._finish(ending, statistics)
            return
        finishing: Background[tuple[str, str]] = Background(lambda said: self._finish(*said), 1, "log-end")
        if behind.close(CLOSE_LIMIT_S):
            finishing.put((ending, statistics))
        if not finishing.close(CLOSE_LIMIT_S) or behind.waiting:
            raise LogError(
                f"the disk under the log {self.path} does not answer: {self.rows} rows were handed to it, "
                f"{behind.waiting} were not, and its head does not say how the run ended"
            )
        for problem in (finishing.problem, behind.problem):
            if problem is not None:
                raise problem

    def _finish(self, ending: str, statistics: str) -> None:
        statistics = statistics or f"{self.rows} ticks"
        try:
            self._say(ending, statistics)
            head = self._head + self._late_lines(ending, statistics) + self._names
            with suppress(LogError):  # a full disk has room for what was there, not for more
                self._write(end_line(self.rows, zlib.crc32(head.encode()), self._rows_crc).encode())
            if self.path is not None:
                _sync(self._file)
                self._file.close()
        except OSError as exc:
            raise LogError(f"cannot finish the log {self.path}: {exc.strerror}; its rows are written") from exc

    def _say(self, ending: str, statistics: str) -> None:
        """Write the lines of the head that are known late, and go back to the end of the file."""
        self._file.seek(self._ending_at)
        self._file.write(self._late_lines(ending, statistics).encode())
        self._file.seek(0, io.SEEK_END)

    def _late_lines(self, ending: str, statistics: str) -> str:
        """The lines of fixed width (in bytes): how the run ended, when and how it had begun."""
        clock = "" if self._bench_time_s is None else f"{self._bench_time_s:.6f}"
        return (
            _fixed(f"# ending: {ending}", _ENDING_BYTES)
            + _fixed(f"# tick_statistics: {statistics}", _STATISTICS_BYTES)
            + _fixed(f"# bench_time_s: {clock}", _CLOCK_BYTES)
            + _fixed(f"# begins: {self._begins}", _BEGINS_BYTES)
        )

    def text(self) -> str:
        """The whole log, of one kept in memory."""
        if not isinstance(self._file, io.BytesIO):
            raise LogError("only a log kept in memory gives its text")
        return self._file.getvalue().decode()

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close("complete" if kind is None else f"stopped: {kind.__name__}")

    def _write(self, data: bytes) -> None:
        size = len(data)
        try:
            written = self._file.write(data)
            while written < len(data):  # a nearly full disk may take a part
                data = data[written:]
                written = self._file.write(data)
            self._whole += size
        except OSError as exc:
            with suppress(OSError):
                self._file.truncate(self._whole)  # no half a row
            raise LogError(
                f"cannot write the log {self.path}: {exc.strerror}; {self.rows} rows are safe in it"
            ) from exc


class NoLog(LogWriter):
    """Counts its rows and keeps none: for long sessions that nobody records."""

    def row(self, *args: object) -> None:
        if self.also is not None:
            self.also(*args)
        self.rows += 1


def _sync(file: BinaryIO) -> None:
    try:
        os.fsync(file.fileno())
    except OSError as exc:
        if exc.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EROFS):  # pipes and some devices cannot be synced
            raise


def _fixed(line: str, size: int) -> str:
    line = one_line(line, size).encode()[:size].decode(errors="ignore")
    return line + " " * (size - len(line.encode())) + "\n"


def one_line(text: str, most: int) -> str:
    """One line, without control characters, so that no value can forge a line of the file."""
    plain = str(text).encode(errors="surrogateescape").decode(errors="replace")  # a name in an odd locale
    return re.sub(r"[\x00-\x1f\x7f\x85\u2028\u2029]+", " ", plain)[:most].strip()
