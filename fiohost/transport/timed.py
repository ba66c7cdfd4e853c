"""A transport that notes when each report came and how long its answer took to be handed over."""

from __future__ import annotations

from collections.abc import Callable

from fiohost.transport.base import Transport, Way


class TimedTransport(Transport):
    """Passes everything through. ``received_s``: times of reports; ``answered_s``: from a report to its answer."""

    def __init__(self, inner: Transport, now_s: Callable[[], float]) -> None:
        self.inner, self._now_s = inner, now_s
        self.received_s: list[float] = []
        self.answered_s: list[float] = []
        self._is_answered = True
        self._take_over()

    def _take_over(self) -> None:
        inner = self.inner
        self.name, self.identity, self.facts = inner.name, inner.identity, inner.facts
        self.passed_over, self.can_reopen = inner.passed_over, inner.can_reopen
        self.is_known_again = inner.is_known_again
        self.lock_step, self.stream, self.counts_per_rev = inner.lock_step, inner.stream, inner.counts_per_rev

    def open(self) -> None:
        self.inner.open()
        self._take_over()

    def reopen(self) -> None:
        self.inner.reopen()
        self._take_over()

    def send(self, report: bytes) -> None:
        self.inner.send(report)
        if not self._is_answered:
            self.answered_s.append(self._now_s() - self.received_s[-1])
            self._is_answered = True

    def receive(self, timeout_s: float) -> bytes:
        report = self.inner.receive(timeout_s)
        self.passed_over = self.inner.passed_over
        self.received_s.append(self._now_s())
        self._is_answered = False
        return report

    @property
    def way(self) -> Way | None:
        return self.inner.way

    def close(self) -> None:
        self.inner.close()
