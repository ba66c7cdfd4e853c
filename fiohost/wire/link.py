"""One conversation over one line: numbers what goes out, makes readings of what comes in, counts what was lost."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from fiohost.errors import ReportError
from fiohost.wire.messages import Codec, Command, Telemetry
from fiohost.wire.stream import StreamParser

MAX_GAP = 64  # numbers that can be missing in a row; beyond it they have begun anew


@dataclass
class LinkCounts:
    """What became of the board's reports. Lost, repeated and late ones show only where a layout numbers them."""

    lost: int = 0  # numbers that never came, or not whole
    repeated: int = 0
    late: int = 0  # older than one that had come
    restarts: int = 0  # the numbers began anew: the board was reset
    garbage_bytes: int = 0  # of a stream, between reports
    refused: Counter[str] = field(default_factory=Counter)  # reports that could not be one, by reason

    def describe(self) -> list[str]:
        """Words for what there is."""
        counts = {
            "reports lost": self.lost,
            "repeated": self.repeated,
            "late": self.late,
            "restarts of the board": self.restarts,
            "bytes of garbage": self.garbage_bytes,
        }
        reasons = ", ".join(f"{reason} {count}" for reason, count in sorted(self.refused.items()))
        return [f"{count} {what}" for what, count in counts.items() if count] + (
            [f"refused: {reasons}"] * bool(reasons)
        )

    def as_dict(self) -> dict[str, object]:
        return {
            "reports_lost": self.lost,
            "reports_repeated": self.repeated,
            "reports_late": self.late,
            "board_restarts": self.restarts,
            "garbage_bytes": self.garbage_bytes,
            "refused_by_reason": dict(self.refused),
        }


class Link:
    """The state of a line that the codec, which has none, does not keep.

    ``steps`` are the board's task steps from the reading before to the newest one: by tick or sequence number where
    the layout is ``numbered``, else by the count of reports. ``passed_over`` counts readings of a stream that came
    together with a newer one.
    """

    def __init__(self, codec: Codec, *, stream: bool = False) -> None:
        self.codec = codec
        self.counts = LinkCounts()
        self.steps = 1
        self.passed_over = 0
        self._sent = -1
        layout = codec.telemetry_layout
        self._parser = StreamParser(layout, codec.decode) if stream else None
        sequence, tick = layout.field("sequence"), layout.field("tick")
        self.numbered = bool(sequence or tick)
        self._spans = {field.name: (1 << 8 * field.size) * field.scale for field in (sequence, tick) if field}
        self._last: Telemetry | None = None
        self._strange: Telemetry | None = None  # not yet believed, its number is far from the last

    def encode(self, command: Command) -> bytes:
        """Bytes of the next command, with its number where the layout has one."""
        self._sent = (self._sent + 1) % self.codec.command_numbers
        return self.codec.encode(command, self._sent)

    def begin(self) -> None:
        """Forget the last number: nobody listened for a while, and what was sent then is not lost."""
        self._last = self._strange = None

    def receive(self, data: bytes, passed_over: int = 0) -> Telemetry | None:
        """The newest reading in a report, or in a piece of a stream; None where the piece completes none.

        *passed_over*: reports that the transport has left out before it. Raises ReportError for a report that cannot
        be one, and for one that is not new.
        """
        parser = self._parser
        if parser is not None and (parser.held or len(data) != parser.length):
            return self._of_stream(parser, data)
        try:
            reading = self.codec.decode(data)
        except ReportError as exc:
            if parser is not None:  # a report may begin within
                return self._of_stream(parser, data)
            self.counts.refused[exc.reason] += 1
            raise
        self.steps = self._follow(reading, passed_over) if self.numbered else 1 + passed_over
        return reading

    def _of_stream(self, parser: StreamParser[Telemetry], data: bytes) -> Telemetry | None:
        parser.problem = None
        found = parser.feed(data)
        self.counts.garbage_bytes += parser.garbage_bytes
        self.counts.refused.update(parser.refused)
        parser.garbage_bytes = 0
        parser.refused.clear()
        newest, steps, problem = None, 0, parser.problem
        for reading in found:
            try:
                steps += self._follow(reading, 0) if self.numbered else 1
            except ReportError as exc:
                problem = exc
                continue
            self.passed_over += newest is not None
            newest = reading
        if newest is not None:
            self.steps = steps
        elif problem is not None:
            raise problem
        return newest

    def _follow(self, reading: Telemetry, passed_over: int) -> int:
        """Steps since the last reading; what is missing in between is counted. Raises ReportError if it is not new."""
        last, counts = self._last, self.counts
        if last is None:
            self._last = reading
            return 1 + passed_over
        ahead = self._ahead(reading, last)
        if ahead == 0:
            counts.repeated += 1
            raise ReportError("the board repeats its last report", "repeated")
        if ahead - passed_over > MAX_GAP:
            self._suspect(reading)
            self._last, self._strange = reading, None
            return 1
        counts.lost += max(0, ahead - 1 - passed_over)
        steps = self._difference("tick", reading, last) if "tick" in self._spans else ahead
        self._last, self._strange = reading, None
        return max(1, steps) if steps <= ahead * MAX_GAP else ahead  # a tick far off the sequence was damaged

    def _suspect(self, reading: Telemetry) -> None:
        """A number far from the last one is late; two in order are a board that counts anew. Raises ReportError."""
        before, self._strange = self._strange, reading
        self.counts.late += 1
        if before is None or not 0 < self._ahead(reading, before) <= MAX_GAP:
            raise ReportError("the board sends a report that is older than the one before", "late")
        self.counts.late -= 2  # neither was
        self.counts.restarts += 1

    def _ahead(self, reading: Telemetry, last: Telemetry) -> int:
        """Reports from *last* to *reading*, by the number that the layout has."""
        return self._difference("sequence" if "sequence" in self._spans else "tick", reading, last)

    def _difference(self, name: str, reading: Telemetry, last: Telemetry) -> int:
        ahead: float = (getattr(reading, name) - getattr(last, name)) % self._spans[name]
        return round(ahead)
