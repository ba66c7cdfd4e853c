"""Reports for human eyes: hex with the changed bytes marked, the fields beside it, and what each byte did.

Of a board whose layout nobody knows this shows it: turn the shaft by hand, and the bytes that move are the count.
"""

from __future__ import annotations

from dataclasses import dataclass

from fiohost.wire.layout import Layout

ROW = 16  # bytes on a line
MOST_BYTES = 4096  # of a report that are looked at


@dataclass
class ByteHistory:
    """What one byte of the reports did."""

    changes: int
    low: int
    high: int
    last: int


class Dump:
    """Follows the reports of one direction."""

    def __init__(self) -> None:
        self.reports = 0
        self.bytes: list[ByteHistory] = []
        self.pairs: list[tuple[int, int]] = []  # lowest and highest little-endian u16 from each offset on

    def changed(self, report: bytes) -> list[bool]:
        """Take up a report; says of each byte whether it differs from the report before (none does in the first)."""
        report = report[:MOST_BYTES]
        marks = []
        for at, byte in enumerate(report):
            if at == len(self.bytes):
                self.bytes.append(ByteHistory(0, byte, byte, byte))
                marks.append(self.reports > 0)
                continue
            history = self.bytes[at]
            marks.append(byte != history.last)
            history.changes += byte != history.last
            history.low, history.high = min(history.low, byte), max(history.high, byte)
            history.last = byte
        for at in range(len(report) - 1):
            value = report[at] | report[at + 1] << 8
            if at == len(self.pairs):
                self.pairs.append((value, value))
            low, high = self.pairs[at]
            self.pairs[at] = min(low, value), max(high, value)
        self.reports += 1
        return marks

    def summary(self) -> list[dict[str, int]]:
        """Of each byte that ever changed: offset, changes, low, high, and the range of the u16 that begins there."""
        rows = []
        for at, byte in enumerate(self.bytes):
            if byte.changes:
                row = {"offset": at, "changes": byte.changes, "low": byte.low, "high": byte.high}
                if at < len(self.pairs):
                    row |= {"u16_low": self.pairs[at][0], "u16_high": self.pairs[at][1]}
                rows.append(row)
        return rows


def hex_rows(report: bytes, marks: list[bool]) -> list[list[tuple[str, bool]]]:
    """Rows of (three characters, whether the byte changed); a changed byte has ``>`` before it.

    Zeros at the end that did not change are left out; a last item says how many.
    """
    shown = min(len(report), MOST_BYTES)
    while shown > 1 and report[shown - 1] == 0 and not marks[shown - 1]:
        shown -= 1
    items = [(f"{'>' if marks[i] else ' '}{report[i]:02x}", marks[i]) for i in range(shown)]
    if len(report) > shown:
        items.append((f" ..+{len(report) - shown}", False))
    return [items[at : at + ROW] for at in range(0, max(len(items), 1), ROW)]


def field_words(layout: Layout, report: bytes) -> str:
    """The fields of a layout as they stand in a report, good or not."""
    return "  ".join(f"{name} {value:.6g}" for name, value in layout.peek(report).items())
