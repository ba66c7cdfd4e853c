"""Simulated boards whose line fails on request, and a bench on one."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from fiohost.bench.loop import Bench
from fiohost.transport.profile import TargetProfile
from fiohost.transport.simulated import SimulatedTransport, plant_board

Receive = Callable[[int, bytes], bytes]
# No wait that ends well is so long: only what hangs reaches it. A first run compiles, on a computer that may have much
# else to do. What a test holds to be fast, it shows by what came first, never by this.
HANG_S = 900.0


def until(what: Callable[[], Any], limit_s: float = HANG_S) -> Any:
    """Wait until *what* gives something true, and give that."""
    deadline = time.monotonic() + limit_s
    while not (found := what()):
        assert time.monotonic() < deadline, "it did not come"
        time.sleep(0.01)
    return found


class WatchedTransport(SimulatedTransport):
    """A simulated board that keeps every report sent to it; *on_receive(k, report)* may change or refuse telemetry."""

    def __init__(self, plant: str = "", on_receive: Receive | None = None) -> None:
        inner = plant_board(plant)
        super().__init__(inner._step, "sim", "simulated", inner.facts)
        self.sent: list[bytes] = []
        self.received = 0
        self._on_receive = on_receive

    def send(self, report: bytes) -> None:
        super().send(report)
        self.sent.append(report)

    def receive(self, timeout_s: float) -> bytes:
        report = super().receive(timeout_s)
        self.received += 1
        return self._on_receive(self.received, report) if self._on_receive else report

    @property
    def braked(self) -> bool:
        """The last report sent says brake: duty 0, C3 C4 = 1 1."""
        return self.sent[-1][:6] == bytes.fromhex("00 00 00 00 01 01")


def bench_on(transport: SimulatedTransport, **limits: float) -> Bench:
    profile = TargetProfile.load()
    return Bench(transport, replace(profile, limits=profile.limits.within(limits)))


def rows_of(path: Path) -> list[str]:
    """Data rows of a log as text."""
    return [line for line in path.read_text().splitlines() if line[:1].isdigit()]
