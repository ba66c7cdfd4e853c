"""A recorded wire trace as a target: gives what the board gave, in the same order, whatever is sent to it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from fiohost.errors import ConfigError, DisconnectedError, TelemetryTimeoutError
from fiohost.transport.base import Transport
from fiohost.transport.profile import TargetProfile
from fiohost.transport.trace import Event, TraceReader


class ReplayTransport(Transport):
    """Plays a trace back. ``profile`` is that of the recorded board. *paced*: at the speed at which it was recorded.

    Raises ConfigError for a file that is no trace.
    """

    def __init__(self, path: str | Path, *, paced: bool = False) -> None:
        self._reader = TraceReader(path)
        head = self._reader.head
        text, name = head.get("profile_toml"), head.get("profile")
        if not isinstance(text, str) or not isinstance(name, str):
            raise ConfigError(f"{path}: the head of the trace has no profile and profile_toml")
        self.profile = TargetProfile.parse(text, name)
        self.name = f"replay:{path}"
        self.identity = str(head.get("identity", ""))[:200]
        self.lock_step, self.stream = head.get("lock_step") is True, head.get("stream") is True
        counts, facts = head.get("counts_per_rev"), head.get("facts")
        self.counts_per_rev = counts if isinstance(counts, int) and 4 <= counts <= 1 << 24 else None
        self.facts = {str(k): str(v) for k, v in facts.items()} if isinstance(facts, dict) else {}
        self.facts["replay_of"] = str(head.get("target", ""))[:200]
        self._paced = paced
        self._events: Iterator[Event] = iter(())
        self._began_s: float  # when it was opened
        self._open = self._ended = False
        self.time_s = 0.0  # of the last event that was played

    def open(self) -> None:
        self._events = self._reader.events()
        self._began_s = time.monotonic()
        self._open, self._ended = True, False

    def send(self, report: bytes) -> None:
        if not self._open:
            raise DisconnectedError("the trace is closed")

    def receive(self, timeout_s: float) -> bytes:
        for event in self._events:
            self.time_s = event.time_s
            if event.direction == "out":
                continue
            if self._paced:
                time.sleep(min(max(0.0, self._began_s + event.time_s - time.monotonic()), 1.0))
            if event.direction == "none":
                raise TelemetryTimeoutError("nothing came in this tick of the trace")
            if event.direction == "gone":
                break
            self.passed_over += event.passed_over
            return event.data
        if self._ended:  # no more is said to a bench that goes on to brake
            raise TelemetryTimeoutError("the trace has ended")
        self._ended = True
        raise DisconnectedError(f"the trace {self._reader.path} ends here")

    def close(self) -> None:
        self._open = False
        self._events = iter(())
