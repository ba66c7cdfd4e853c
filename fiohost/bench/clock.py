"""The bench's clock: real, with absolute deadlines on the monotonic clock, or virtual, where waiting costs nothing."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable


class Clock(ABC):
    """``wait_until`` returns at or after a time of ``now_s``, and how late it is (s)."""

    real: bool = False

    @abstractmethod
    def now_s(self) -> float: ...

    @abstractmethod
    def wait_until(self, deadline_s: float) -> float: ...


class VirtualClock(Clock):
    """Time passes when somebody waits for it: a simulated board then runs as fast as it can."""

    def __init__(self) -> None:
        self._now_s = 0.0

    def now_s(self) -> float:
        return self._now_s

    def wait_until(self, deadline_s: float) -> float:
        self._now_s = max(self._now_s, deadline_s)
        return 0.0


class MonotonicClock(Clock):
    """The host's monotonic clock. Deadlines are absolute, so that one late tick does not delay the next."""

    real = True

    now_s = staticmethod(time.monotonic)

    def wait_until(self, deadline_s: float) -> float:
        left = deadline_s - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        return max(0.0, time.monotonic() - deadline_s)


class PlayedClock(Clock):
    """The clock of a recorded run: it stands where the recording does, so that what was late then is late again."""

    real = True

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s

    def now_s(self) -> float:
        return self._now_s()

    def wait_until(self, deadline_s: float) -> float:
        return max(0.0, self._now_s() - deadline_s)
