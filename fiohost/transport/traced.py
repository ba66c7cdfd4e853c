"""A transport that tells what crosses it: as hex to the log of the process (``--debug``), as lines to a trace file."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from fiohost.errors import DisconnectedError, LogError, TelemetryTimeoutError
from fiohost.transport.base import Transport, Way
from fiohost.transport.trace import TraceWriter

traffic = logging.getLogger("fiohost.traffic")


class TracedTransport(Transport):
    """Passes everything through. *now_s* is the bench's clock; *head* is what the trace says first."""

    def __init__(
        self,
        inner: Transport,
        trace: TraceWriter | None = None,
        now_s: Callable[[], float] = lambda: 0.0,
        head: Mapping[str, Any] | None = None,
    ) -> None:
        self.inner = inner
        self._trace, self._now_s, self._head = trace, now_s, head or {}
        self._debug = traffic.isEnabledFor(logging.DEBUG)
        self._take_over()

    def _take_over(self) -> None:
        """What a medium may know only once it is open."""
        inner = self.inner
        self.name, self.identity, self.facts = inner.name, inner.identity, inner.facts
        self.can_reopen = inner.can_reopen
        self.is_known_again = inner.is_known_again
        self.lock_step, self.stream, self.counts_per_rev = inner.lock_step, inner.stream, inner.counts_per_rev

    def open(self) -> None:
        self.inner.open()
        self._take_over()
        if self._trace is not None:
            what = {
                "target": self.name,
                "identity": self.identity,
                "lock_step": self.lock_step,
                "stream": self.stream,
                "counts_per_rev": self.counts_per_rev,
                "facts": dict(self.facts),
            }
            try:
                self._trace.session({**what, **self._head}, self._now_s())
            except LogError:
                self.inner.close()
                raise

    def reopen(self) -> None:
        self.inner.reopen()
        self._take_over()

    def send(self, report: bytes) -> None:
        if self._debug:
            traffic.debug("out %3d: %s", len(report), report.rstrip(b"\0").hex(" "))
        try:
            self.inner.send(report)
        except DisconnectedError:
            self._tell("gone")
            raise
        self._tell("out", report)

    def receive(self, timeout_s: float) -> bytes:
        before = self.inner.passed_over
        try:
            report = self.inner.receive(timeout_s)
        except TelemetryTimeoutError:
            self._tell("none")
            raise
        except DisconnectedError:
            self._tell("gone")
            raise
        self.passed_over = self.inner.passed_over
        if self._debug:
            traffic.debug("in  %3d: %s", len(report), report.rstrip(b"\0").hex(" "))
        self._tell("in", report, self.passed_over - before)
        return report

    @property
    def way(self) -> Way | None:
        return self.inner.way

    def close(self) -> None:
        self.inner.close()

    def _tell(self, direction: str, data: bytes = b"", passed_over: int = 0) -> None:
        if self._trace is not None:
            self._trace.event(self._now_s(), direction, data, passed_over)


def is_debugged() -> bool:
    """Whether traffic in hex was asked for."""
    return traffic.isEnabledFor(logging.DEBUG)
