"""The line as the bench has it, tick by tick: a command out, the newest reading in, and the board's steps counted.

A tick without telemetry, or with a report that cannot be one, is counted and passed over; ``silence_s`` of them in a
row are an error. A lock-step board is paced by the clock, any other keeps its own time.
"""

from __future__ import annotations

from fiohost.bench.clock import Clock
from fiohost.bench.guardian import Guardian
from fiohost.bench.statistics import TickStatistics
from fiohost.errors import ReportError, TelemetryTimeoutError, TransportError
from fiohost.transport.base import Transport
from fiohost.transport.profile import TargetProfile
from fiohost.wire.link import Link
from fiohost.wire.messages import Command, Telemetry

GAP_S = 0.1  # after so long without a reading, queues may have lost reports: the clock counts too
LATE_TICKS = 1.5
SLEPT_S = 1.0  # the host slept: it does not hurry through the ticks of that time


class Line:
    """One open transport. ``steps`` are those of the board's task, as far as they are known; ``read_s`` is when the
    last reading came; ``statistics`` are of the ticks since :meth:`count_anew`.
    """

    def __init__(self, transport: Transport, profile: TargetProfile, clock: Clock) -> None:
        self.transport = transport
        self.profile = profile
        self.clock = clock
        self.link = Link(profile.codec, stream=transport.stream)
        self.guardian: Guardian | None = None  # hears of each turn
        self.steps = 0
        self.read_s = self._due_s = clock.now_s()
        self._steps_read = 0  # the steps at the last reading
        self._lost_in_a_row = 0
        self._silence_s = profile.guards.silence_s
        self._silence = (
            f"no telemetry for {1e3 * self._silence_s:g} ms: the board stopped sending; check power and cable"
        )
        self.host_was_late = False  # in the last tick: not the board
        self.steps_are_a_guess = False  # those up to the last reading: the clock was asked
        self.count_anew()

    def send(self, command: Command) -> None:
        """Raises TransportError, DisconnectedError."""
        self.transport.send(self.link.encode(command))

    def count_anew(self) -> None:
        """Statistics of what follows."""
        self.statistics = TickStatistics(self.profile.sample_time_s, real=self.clock.real)
        self.link.counts = self.statistics.link

    def begin(self) -> None:
        """Nobody listened for a while: that is neither loss nor lateness."""
        if self.clock.real:  # what is due is waited for in lock step alone
            self._due_s = self.clock.now_s()
        self.link.begin()

    def tick(self) -> Telemetry | None:
        """Telemetry of this tick, or None where nothing came that could be one. Raises ReportError or
        TelemetryTimeoutError after ``silence_s`` of nothing, DisconnectedError.
        """
        lock_step = self.transport.lock_step
        late_s = self._wait() if lock_step else None  # else it is known only when a reading has come
        before_s = self.clock.now_s()
        statistics = self.statistics
        unread, turned_s = statistics.passed_over, before_s - self.read_s
        try:
            reading = self._newest(before_s)
        except TelemetryTimeoutError as exc:
            if not lock_step:
                raise TelemetryTimeoutError(f"{self._silence} ({exc})") from exc
            statistics.silent += 1
            problem: TransportError = exc
        except ReportError as exc:
            statistics.refused += 1
            problem = exc
        else:
            if late_s is None:
                late_s = self.read_s - before_s - self.profile.sample_time_s
                self._judge(turned_s, self.read_s - before_s, statistics.passed_over - unread)
            statistics.count(late_s)
            self._lost_in_a_row = 0
            return reading
        statistics.count(self.clock.now_s() - before_s - self.profile.sample_time_s if late_s is None else late_s)
        self._lost_in_a_row += 1
        if self._lost_in_a_row * self.profile.sample_time_s >= self._silence_s:
            self._lost_in_a_row = 0
            if isinstance(problem, ReportError):
                raise problem
            raise TelemetryTimeoutError(self._silence) from problem
        return None

    def _judge(self, turned_s: float, waited_s: float, unread: int) -> None:
        """Whether this computer was late: it came back late, or woke late to more reports than one.

        A board that sends more often is met with several reports too, but in time.
        """
        limit_s = LATE_TICKS * self.profile.sample_time_s
        self.host_was_late = turned_s > limit_s or (waited_s > limit_s and unread > 0)
        if self.host_was_late:
            self.statistics.host_late += max(1, unread)

    def newest(self) -> Telemetry:
        """The newest reading, waited for as long as ``silence_s``, of whatever tick.

        Raises TelemetryTimeoutError, ReportError, DisconnectedError.
        """
        return self._newest(self.clock.now_s())

    def _wait(self) -> float:
        """Wait until this tick is due; how late it is (s)."""
        late_s = self.clock.wait_until(self._due_s)
        self._due_s += self.profile.sample_time_s
        if late_s > SLEPT_S:
            self._due_s = self.clock.now_s() + self.profile.sample_time_s
        return late_s

    def _newest(self, now_s: float) -> Telemetry:
        transport, link = self.transport, self.link
        if self.guardian is not None:
            self.guardian.beat()
        deadline_s, left_s = now_s + self._silence_s, self._silence_s
        unseen, unread = transport.passed_over, link.passed_over
        self.steps += 1  # holds where nothing comes that tells more
        problem: ReportError | None = None
        try:
            while True:
                before = transport.passed_over
                data = transport.receive(left_s)
                try:
                    reading = link.receive(data, transport.passed_over - before)
                except ReportError as exc:
                    if not transport.stream:
                        raise
                    reading, problem = None, exc
                if reading is not None:
                    break
                left_s = deadline_s - self.clock.now_s()
                if left_s <= 0.0:  # a stream of garbage never ends by itself
                    raise TelemetryTimeoutError(f"no good report for {1e3 * self._silence_s:g} ms") from problem
        finally:
            self.statistics.passed_over += transport.passed_over - unseen + link.passed_over - unread
        self._count_steps()
        return reading

    def _count_steps(self) -> None:
        """The board's step of the reading that has just come."""
        link, now_s = self.link, self.clock.now_s()
        self.steps_are_a_guess = False
        if link.numbered:
            self.steps = self._steps_read + link.steps
        elif not self.transport.lock_step:
            self.steps += link.steps - 1
            since_s = now_s - self.read_s
            self.steps_are_a_guess = since_s > GAP_S
            if self.steps_are_a_guess:
                self.steps = max(self.steps, self._steps_read + round(since_s / self.profile.sample_time_s))
        self._steps_read, self.read_s = self.steps, now_s
