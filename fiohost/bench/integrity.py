"""The last line of a log: how many rows it has and what its bytes add up to; and whether a file still fits it.

``# end: rows=1514 crc32_head=0f3a91c2 crc32_rows=77d0b1e4``: head are all bytes before the first row, rows all bytes
from there to this line. A log that was cut off has no such line, one that was altered does not fit it.
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass

import numpy as np

from fiohost.bench.head import MAX_METADATA_LINES

PREFIX = "# end: "
_END = re.compile(rb"# end: rows=(\d{1,12}) crc32_head=([0-9a-f]{8}) crc32_rows=([0-9a-f]{8})\n?")
BLOCK = 1 << 18  # bytes that are looked at at a time
WHOLE, CUT_OFF, ALTERED, UNKNOWN = "whole", "cut off", "altered", "unknown"


def end_line(rows: int, head_crc: int, rows_crc: int) -> str:
    return f"{PREFIX}rows={rows} crc32_head={head_crc:08x} crc32_rows={rows_crc:08x}\n"


@dataclass(frozen=True)
class Integrity:
    """What became of a log's bytes: its state, the rows that are there, those that should be (None: nobody knows), and
    sentences on what is wrong.
    """

    state: str
    rows: int
    rows_written: int | None
    notes: tuple[str, ...]


def judge(data: bytes) -> Integrity:
    """Hold the bytes of a log against its last line."""
    begin = data.rfind(b"\n" + PREFIX.encode()) + 1  # of the line that ought to be the last
    found = _END.match(data, begin)
    if found is None or not begin:
        return _without_end(data)
    at = _first_row(data, begin)
    head, rows = memoryview(data)[:at], memoryview(data)[at:begin]  # no copies: logs are large
    there, written = line_ends(data, at, begin), int(found[1])
    notes = []
    if there != written:
        what = f"{written - there} rows are missing" if there < written else f"{there - written} rows were added"
        notes.append(f"{what}: {there} are there, {written} were written")
    if zlib.crc32(rows) != int(found[3], 16):
        notes.append("the rows are not those that were written")
    if zlib.crc32(head) != int(found[2], 16):
        notes.append("the head is not the one that was written")
    behind = len(data) - found.end()
    if behind:
        notes.append(f"{behind} bytes were added behind its last line")
    return Integrity(ALTERED if notes else WHOLE, there, written, tuple(notes))


def _without_end(data: bytes) -> Integrity:
    at = _first_row(data, len(data))
    head = data[:at]
    whole = line_ends(data, at)
    notes = []
    if not data:
        return Integrity(UNKNOWN, 0, None, ())
    if not data.endswith(b"\n"):
        notes.append("the last line is cut off in its middle")
    if b"\n# host_version:" not in head and not head.startswith(b"# host_version:"):
        notes.append("it has no last line with row count and check sum: another program made it")
        return Integrity(UNKNOWN, whole, None, tuple(notes))
    if b"\n# ending: unfinished" in head:
        notes.append("the host did not close it: it was killed, or its computer died")
    else:
        notes.append("its last line with row count and check sum is missing: the end of the file is lost")
    return Integrity(CUT_OFF, whole, None, tuple(notes))


def line_ends(data: bytes, start: int = 0, end: int | None = None) -> int:
    """How many there are; by numpy, which looks at many bytes at once."""
    codes = np.frombuffer(data, np.uint8)[start:end]
    return sum(int(np.count_nonzero(codes[i : i + BLOCK] == ord("\n"))) for i in range(0, codes.size, BLOCK))


def _first_row(data: bytes, end: int) -> int:
    """Where the rows begin, behind metadata and column names; *end* where there are none, or too long a head."""
    at = 0
    for _ in range(MAX_METADATA_LINES + 1):
        is_row = not data.startswith((b"#", b"\xef\xbb\xbf#", b"\n"), at, end)
        found = data.find(b"\n", at, end)
        if found < 0:
            return end
        at = found + 1
        if is_row:  # the column names
            return at
    return end
