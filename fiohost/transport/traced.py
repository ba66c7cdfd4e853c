"""Hex traffic for ``--debug``: a transport that tells the log of the process what crosses it."""

from __future__ import annotations

import logging

from fiohost.transport.base import Transport

traffic = logging.getLogger("fiohost.traffic")


class TracedTransport(Transport):
    """Passes everything through, and writes each report as hex with trailing zeros left out."""

    def __init__(self, inner: Transport) -> None:
        self.inner = inner
        self.name, self.identity = inner.name, inner.identity
        self.lock_step, self.facts, self.counts_per_rev = inner.lock_step, inner.facts, inner.counts_per_rev

    def open(self) -> None:
        self.inner.open()

    def send(self, report: bytes) -> None:
        traffic.debug("out %3d: %s", len(report), report.rstrip(b"\0").hex(" "))
        self.inner.send(report)

    def receive(self, timeout_s: float) -> bytes:
        report = self.inner.receive(timeout_s)
        self.passed_over = self.inner.passed_over
        traffic.debug("in  %3d: %s", len(report), report.rstrip(b"\0").hex(" "))
        return report

    def close(self) -> None:
        self.inner.close()


def traced(transport: Transport) -> Transport:
    """*transport*, traced where debugging of traffic is on."""
    return TracedTransport(transport) if traffic.isEnabledFor(logging.DEBUG) else transport
