"""Reports out of a stream of bytes that has no borders: a serial line.

The parser looks for the header, takes as many bytes as the layout is long and asks the reader whether they are a good
report. Where they are not, it goes on one byte further, so that a report hidden behind a false header is found. After
any garbage at most the first good report is lost: it can be only where the garbage ends in what looks like a whole good
report together with the first bytes of it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Generic, TypeVar

from fiohost.errors import ReportError
from fiohost.wire.layout import Layout

Message = TypeVar("Message")
PIECE = 4096  # bytes taken up at a time, so that memory stays bounded whatever comes


class StreamParser(Generic[Message]):
    """Feed it bytes as they come; it gives the messages in them. *read* raises ReportError for what is none.

    ``reports`` counts messages, ``garbage_bytes`` bytes between them, ``refused`` by reason what began like a report
    and was none. ``held`` is what waits for the rest of its report; it is never more than PIECE bytes and one report.
    """

    def __init__(self, layout: Layout, read: Callable[[bytes], Message]) -> None:
        self.length = layout.length
        self._start = (b"" if layout.report_id is None else bytes([layout.report_id])) + layout.header
        self._read = read
        self.held = bytearray()
        self.reports = 0
        self.garbage_bytes = 0
        self.refused: Counter[str] = Counter()
        self.problem: ReportError | None = None  # the last one

    def feed(self, data: bytes) -> list[Message]:
        """Messages that are whole with *data*, in their order."""
        found: list[Message] = []
        for at in range(0, len(data), PIECE):
            self.held += data[at : at + PIECE]
            self._parse(found)
        return found

    def _parse(self, found: list[Message]) -> None:
        held, length, start = self.held, self.length, self._start
        at = 0
        while len(held) - at >= length:
            begins = held.find(start, at) if start else at
            if begins < 0:  # the last bytes may be the beginning of a header
                begins = len(held) - len(start) + 1
            self.garbage_bytes += begins - at
            at = begins
            if len(held) - at < length:
                break
            try:
                found.append(self._read(bytes(held[at : at + length])))
            except ReportError as exc:
                self.refused[exc.reason] += 1
                self.problem = exc
                self.garbage_bytes += 1
                at += 1
            else:
                self.reports += 1
                at += length
        del held[:at]
