"""A wire trace: everything that crossed a line, one JSON object a line, readable by eye and by any program.

The first object of a session says what it is of (its keys are in docs/protocol.md); then each line is one event with
the time ``t`` in seconds since the session began: ``{"t": 0.005, "dir": "in", "hex": "00 67 01"}``. ``dir`` is ``out``
(host to board), ``in``, ``none`` (nothing came while the host waited) or ``gone`` (the board went away). Every line is
written as it happens; a trace that ends in mid-line is read up to there.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from fiohost import files
from fiohost.background import Background
from fiohost.errors import ConfigError, FiohostError, LogError

SCHEMA = "fiohost.trace/1"
DIRECTIONS = ("out", "in", "none", "gone")
MAX_LINE_BYTES = 100_000
MAX_TRACE_BYTES = 10_000_000_000  # read line by line
MAX_WAITING = 1000  # lines that a disk may be behind: 2.5 s at 5 ms
CLOSE_LIMIT_S = 5.0


@dataclass(frozen=True)
class Event:
    """One line of a trace. ``passed_over``: reports that came with this one and were never read."""

    time_s: float
    direction: str
    data: bytes = b""
    passed_over: int = 0


class TraceWriter:
    """Writes one trace, of any number of sessions. Raises LogError where the file cannot be written.

    A session on a real line is written by a thread of its own: a disk that does not answer must not hold up the loop.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._behind: Background[bytes] | None = None
        self._origin_s = 0.0
        self._file: BinaryIO | None = None
        try:
            files.claim(path, "the trace")
        except FiohostError as exc:
            raise LogError(f"{exc}; nothing was driven") from exc
        self._works, self._said = True, False

    def session(self, head: Mapping[str, Any], now_s: float) -> None:
        """Begin a session, one bench on one line; its times begin at 0."""
        self._origin_s = now_s
        if self._file is None:  # only now: what was there before may be what is to be replayed
            try:
                self._file, _ = files.open_log(self.path, "the trace")  # a line is one write: a killed host loses none
            except FiohostError as exc:
                raise LogError(f"{exc}; nothing was driven") from exc
        if self._behind is None and not head.get("lock_step"):
            self._behind = Background(self._write, MAX_WAITING, "trace")
        self._line({"schema": SCHEMA, **head})

    def event(self, now_s: float, direction: str, data: bytes = b"", passed_over: int = 0) -> None:
        line: dict[str, Any] = {"t": round(now_s - self._origin_s, 6), "dir": direction}
        if data:
            line["hex"] = data.hex(" ")
        if passed_over:
            line["passed_over"] = passed_over
        self._line(line)

    def close(self) -> None:
        """Raises LogError where not all could be written."""
        self._works = False
        behind = self._behind
        if behind is not None and not behind.close(CLOSE_LIMIT_S):
            raise LogError(f"the disk under the trace {self.path} does not answer: {behind.waiting} lines are lost")
        if self._file is not None:
            self._file.close()
        if behind is not None and behind.problem is not None and not self._said:
            raise behind.problem

    def _line(self, content: dict[str, Any]) -> None:
        if not self._works:  # said once; the brake must go out whatever the disk does
            return
        data = json.dumps(content, ensure_ascii=False).encode() + b"\n"
        behind = self._behind
        try:
            if behind is None:
                self._write(data)
            elif behind.problem is not None:
                raise behind.problem
            elif not behind.put(data):
                raise LogError(f"cannot write the trace {self.path}: the disk takes nothing; what was written is safe")
        except LogError:
            self._works, self._said = False, True
            raise

    def _write(self, data: bytes) -> None:
        assert self._file is not None
        try:
            while data:  # a nearly full disk may take a part
                data = data[self._file.write(data) or 0 :]
        except OSError as exc:
            raise LogError(f"cannot write the trace {self.path}: {exc.strerror}; what was written is safe") from exc

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class TraceReader:
    """Reads a trace line by line, so that one of any length needs little memory. Raises ConfigError."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        with files.open_input(path, MAX_TRACE_BYTES, "the trace", ConfigError) as file:
            first = file.readline(MAX_LINE_BYTES + 1)
        head = _object(first)
        if head is None or head.get("schema") != SCHEMA:
            raise ConfigError(f"{path} is not a trace: its first line is no head with the schema {SCHEMA}")
        self.head = head

    def events(self) -> Iterator[Event]:
        """The events in their order, of all sessions. Raises ConfigError for a line that is none."""
        try:
            with files.open_input(self.path, MAX_TRACE_BYTES, "the trace", ConfigError) as file:
                number = 0
                while line := file.readline(MAX_LINE_BYTES + 1):
                    number += 1
                    if not line.endswith(b"\n"):
                        if len(line) > MAX_LINE_BYTES:
                            raise self._fail(number, f"is longer than {MAX_LINE_BYTES} bytes")
                        return  # cut off in mid-line by a crash
                    content = _object(line)
                    if content is None:
                        raise self._fail(number, "is not a JSON object")
                    if "schema" not in content:
                        yield self._event(number, content)
                    elif content.get("profile_toml") != self.head.get("profile_toml"):
                        raise self._fail(number, "begins a session with another target profile: cut the file there")
        except OSError as exc:
            raise ConfigError(f"cannot read the trace {self.path}: {exc.strerror}") from exc

    def _event(self, number: int, content: dict[str, Any]) -> Event:
        try:
            event = Event(
                float(content["t"]),
                content["dir"],
                bytes.fromhex(content.get("hex", "")),
                int(content.get("passed_over", 0)),
            )
        except (KeyError, TypeError, ValueError, OverflowError) as exc:
            raise self._fail(number, f"is not an event with t, dir and hex ({type(exc).__name__}: {exc})") from exc
        if event.direction not in DIRECTIONS or not 0 <= event.passed_over < 1 << 32 or abs(event.time_s) > 1e12:
            raise self._fail(number, f"is not an event: dir is one of {', '.join(DIRECTIONS)}")
        return event

    def _fail(self, number: int, what: str) -> ConfigError:
        return ConfigError(f"{self.path} line {number} {what}")


def _object(line: bytes) -> dict[str, Any] | None:
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None
