"""Whether this computer keeps up with a real board: a loop that stood still ends the run, braked.

Three look at it. The loop itself, before it sends the next command; an alarm that ends a controller which never comes
back; and the guardian, which brakes meanwhile and when there is no loop any more.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from fiohost.bench.line import Line
from fiohost.errors import HostError

ALARM_GAPS = 2.5  # a controller is ended after so many times the gap at which the guardian brakes


class HostWatch:
    """Watches one run. On a simulated board, which waits for its host, it does nothing."""

    def __init__(self, line: Line) -> None:
        self._clock, self._guardian = line.clock, line.guardian
        self._gap_s = line.profile.guards.gap_s
        self._is_on = line.transport.can_reopen and line.clock.real
        self._last_s = line.clock.now_s()
        self._rings = False

    def turn(self) -> None:
        """The loop has come round. Raises HostError where that took too long."""
        if not self._is_on:
            return
        now_s = self._clock.now_s()
        since_s, self._last_s = now_s - self._last_s, now_s
        if self._rings:
            self._set_alarm()
        guardian = self._guardian
        if since_s > self._gap_s or (guardian is not None and guardian.has_braked):
            raise self._late(since_s)
        if guardian is not None and not guardian.answers(now_s):
            raise HostError(
                "the guardian of the motor does not answer: somebody ended or stopped it; the motor was braked"
            )

    @contextmanager
    def alarmed(self) -> Iterator[None]:
        """Within it what runs in this thread is ended when no turn comes. Not where Python has no such alarm."""
        if (
            not self._is_on
            or not hasattr(signal, "setitimer")
            or threading.current_thread() is not threading.main_thread()
        ):
            yield
            return
        before = signal.signal(signal.SIGALRM, self._ring)
        self._rings = True
        try:
            self._set_alarm()  # the first step of a program may be the one that never comes back
            yield
        finally:
            self._rings = False
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)

    def _set_alarm(self) -> None:
        signal.setitimer(signal.ITIMER_REAL, ALARM_GAPS * self._gap_s)

    def _ring(self, signum: int, frame: FrameType | None) -> None:
        if self._rings:
            raise self._late(self._clock.now_s() - self._last_s)

    def _late(self, gap_s: float) -> HostError:
        return HostError(
            f"this computer held fiohost up for {max(gap_s, self._gap_s):.2f} s in mid-run, longer than the "
            f"{self._gap_s:g} s that a motor may go unwatched (guards.gap_s): the motor was braked; end other "
            "programs, take load off disk and cores, or look at a controller that takes too long"
        )
