"""The bench: the tick loop between a program and a board, with a safe stop and a log.

Each turn: take telemetry k, ask the program, send command k, log both. A tick without telemetry, or with a report that
cannot be one, is counted and passed over: nothing is sent, the board holds its outputs, the log has no row. Whatever
ends a run (its program, Ctrl-C, a signal, an exception in a controller, 50 ms without a good report, a full disk), the
board is braked first; then the log is closed, complete.
"""

from __future__ import annotations

import logging
import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from fiohost import __version__
from fiohost.bench import cable
from fiohost.bench.clock import Clock, MonotonicClock, VirtualClock
from fiohost.bench.experiment import Experiment
from fiohost.bench.limits import Limiter
from fiohost.bench.log import Log, LogWriter
from fiohost.bench.program import Hold, Program
from fiohost.bench.statistics import TickStatistics
from fiohost.bench.stop import Stopped, StopSignals
from fiohost.bench.unwrap import Unwrapper
from fiohost.bench.writer import NoLog
from fiohost.errors import (
    ConfigError,
    FiohostError,
    LogError,
    ReportError,
    TelemetryTimeoutError,
    TransportError,
)
from fiohost.transport.base import Transport
from fiohost.transport.profile import TargetProfile
from fiohost.wire.link import Link
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command, Telemetry

logger = logging.getLogger("fiohost.bench")

TELEMETRY_TIMEOUT_S = 0.05
SILENCE = f"no telemetry for {1e3 * TELEMETRY_TIMEOUT_S:g} ms: the board stopped sending; check power and cable"
REST_S = 0.1  # at rest: no count for this long
SETTLE_LIMIT_S = 5.0
BRAKE_REPEATS = 5  # a brake may be lost on its way, and nobody else would send another
STILL_TICKS = 5  # a braked shaft is believed to stand after this many equal readings, and as many in silence
BRAKE_LIMIT_S = 1.0
SILENT_TICKS = 3  # a target that takes one packet a step works off what is under way before it is sent more
GAP_S = 0.1  # after so long without a reading, queues may have lost reports: the clock counts too
COMMAND_DELAY_TICKS = 1  # the board latches the answer to telemetry k at step k+1


class Tick(NamedTuple):
    """One turn of the loop, for those who watch."""

    time_s: float
    command: Command
    pos: int
    direction: int
    angle_deg: float  # unwrapped, POS/2
    ref_deg: float | None


Progress = Callable[[Tick], None]


class Bench:
    """One board on one line. A context manager: leaving it brakes and closes the line.

    Made by :func:`fiohost.connect`. *clock* is real where the board keeps its own time or ``--realtime`` is asked.
    *reconnect_s*: so long a board that went away is waited for, to brake it as soon as it is back.
    """

    def __init__(
        self,
        transport: Transport,
        profile: TargetProfile,
        *,
        clock: Clock | None = None,
        run_id: str | None = None,
        reconnect_s: float = 0.0,
    ) -> None:
        self.transport = transport
        self.reconnect_s = reconnect_s
        self.profile = profile = profile.with_counts(transport.counts_per_rev)
        self.sample_time_s = profile.sample_time_s
        self.counts_per_rev = profile.counts_per_rev
        self.clock = clock or (VirtualClock() if transport.lock_step else MonotonicClock())
        self.run_id = run_id or secrets.token_hex(8)  # of all logs of this bench; random, made from nothing
        self._link = Link(profile.codec, stream=transport.stream)
        self._due_s = self.clock.now_s()
        self._opened_s = self._due_s
        self._steps = 0  # of the board's task, as far as they are known
        self._steps_read = 0  # the same at the last reading
        self._read_s = self._due_s  # when the last reading came
        self._lost_in_a_row = 0
        self._count_anew()
        transport.open()
        if not transport.lock_step:
            cable.greet(transport, self._link.encode(BRAKE_COMMAND), self.clock, profile.watchdog_s)
        layout = f"{profile.name} (layout {profile.status})"
        logger.info("opened %s: %s, profile %s, run %s", transport.name, transport.identity, layout, self.run_id)

    # ---- for users ----------------------------------------------------------------------------------------------

    def run(
        self,
        experiment: Experiment | str,
        log_path: str | Path | None = None,
        *,
        extra_metadata: Mapping[str, str] | None = None,
        progress: Progress | None = None,
        progress_every_s: float = 0.1,
    ) -> Log:
        """Run an experiment (or the shipped one of that name) from rest; without *log_path* its log stays in memory.

        Raises FiohostError where something failed and Stopped on a signal, in both cases after the safe stop.
        """
        if isinstance(experiment, str):
            experiment = Experiment.load(experiment)
        if abs(experiment.sample_time_s - self.sample_time_s) > 1e-9:
            raise ConfigError(
                f"experiment {experiment.name!r} wants ticks of {1e3 * experiment.sample_time_s:g} ms, "
                f"but the board's task runs every {1e3 * self.sample_time_s:g} ms: change sample_time_s"
            )
        metadata = {**experiment.describe(), **(extra_metadata or {})}
        return self.play(experiment.program(), log_path, metadata, progress, progress_every_s)

    def drive(
        self,
        duty_pct: float,
        duration_s: float | None = None,
        log_path: str | Path | None = None,
        *,
        standby: bool = False,
        progress: Progress | None = None,
        progress_every_s: float = 0.1,
    ) -> Log:
        """Hold one signed duty (0 brakes; *standby* coasts) for *duration_s*, or until a signal comes.

        Raises LimitError for a duty beyond +-100 or NaN.
        """
        command = STANDBY_COMMAND if standby else Command.drive(duty_pct)
        ticks = None if duration_s is None else max(1, round(duration_s / self.sample_time_s))
        metadata = {"experiment": "manual", "loop": "open"}
        return self.play(Hold(command, ticks), log_path, metadata, progress, progress_every_s)

    def play(
        self,
        program: Program,
        log_path: str | Path | None = None,
        metadata: Mapping[str, str] | None = None,
        progress: Progress | None = None,
        progress_every_s: float = 0.1,
    ) -> Log:
        """Run any program from rest until it ends, then brake. The log is opened before anything moves."""
        writer = LogWriter(log_path, {**self._head(), **(metadata or {})}, host_time=self.clock.real)
        self._record(program, writer, progress, progress_every_s)
        return Log.read(writer.path) if writer.path is not None else Log.parse(writer.text())

    def live(
        self,
        program: Program,
        log_path: str | Path | None = None,
        metadata: Mapping[str, str] | None = None,
        progress: Progress | None = None,
        progress_every_s: float = 0.1,
    ) -> int:
        """As :meth:`play`, for sessions of any length: without *log_path* rows are counted, not kept. Gives rows."""
        kind = NoLog if log_path is None else LogWriter
        writer = kind(log_path, {**self._head(), **(metadata or {})}, host_time=self.clock.real)
        self._record(program, writer, progress, progress_every_s)
        return writer.rows

    def _record(self, program: Program, writer: LogWriter, progress: Progress | None, progress_every_s: float) -> None:
        ending = "complete"
        self._count_anew()
        try:
            with StopSignals() as stop, self._braked_after(stop):
                self._settle(stop)
                every = max(1, round(progress_every_s / self.sample_time_s))
                writer.bench_time_s = self._bench_time_s()
                with stop.interruptible():
                    self._turns(program, writer, stop, progress, every)
            stop.check()  # a signal during the last brake is an end by signal too
        except BaseException as exc:
            ending = str(exc) if isinstance(exc, Stopped) else f"stopped: {type(exc).__name__}: {exc}"
            try:
                writer.close(ending, self.statistics.describe())
                if writer.path is not None:
                    exc.add_note(f"the log {writer.path} is closed with its {writer.rows} rows")
            except LogError as failed:
                exc.add_note(str(failed))
            raise
        writer.close(ending, self.statistics.describe())

    def settle(self) -> None:
        """Brake until the shaft is at rest (no count for 0.1 s), at most for 5 s."""
        with StopSignals() as stop, self._braked_after(stop):
            self._settle(stop)

    def close(self) -> None:
        """Brake and give the line back; harmless when done twice."""
        try:
            self._brake()
        finally:
            self.transport.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except TransportError:
            if value is None:
                raise

    # ---- the loop -----------------------------------------------------------------------------------------------

    def _turns(
        self, program: Program, writer: LogWriter, stop: StopSignals, progress: Progress | None, every: int
    ) -> None:
        step, send, encode, row = program.step, self.transport.send, self._link.encode, writer.row
        unwrap = Unwrapper(self.counts_per_rev).update
        deg = 360.0 / self.counts_per_rev
        limiter, carried = Limiter(self.profile.limits, self.sample_time_s), self._link.codec.carried
        real, begin, shown = self.clock.real, 0.0, -every
        first = self._steps + 1
        while True:
            if stop.requested:
                stop.check()
            reading = self._receive()
            k = max(0, self._steps - first)
            if real and not begin:
                begin = self.clock.now_s()
            if reading is None:
                continue
            direction, pos, _, _ = reading
            angle = unwrap(pos) * deg
            answer = step(k, angle)
            if answer is None:
                return
            command, ref = answer
            time_s = k * self.sample_time_s
            command = carried(limiter.allow(command, angle, time_s))
            self.statistics.slowed = limiter.slowed
            send(encode(command))
            host = self.clock.now_s() - begin if real else None
            row(time_s, command.duty_pct, command.c3, command.c4, pos, direction, ref, angle, host)
            if progress is not None and k // every != shown:
                shown = k // every
                progress(Tick(time_s, command, pos, direction, angle, ref))

    def _receive(self) -> Telemetry | None:
        """Telemetry of this tick, or None where nothing came that could be one. A lock-step board is paced by the
        clock, any other keeps its own time. Raises after TELEMETRY_TIMEOUT_S of nothing.
        """
        lock_step = self.transport.lock_step
        before = self.clock.now_s()
        if lock_step:
            late_s = self.clock.wait_until(self._due_s)
            self._due_s += self.sample_time_s
            if late_s > 1.0:  # the host slept: do not hurry through the ticks of that time
                self._due_s = self.clock.now_s() + self.sample_time_s
        statistics = self.statistics
        reading: Telemetry | None = None
        problem: TransportError | None = None
        try:
            reading = self._read()
        except TelemetryTimeoutError as exc:
            if not lock_step:
                raise TelemetryTimeoutError(f"{SILENCE} ({exc})") from exc
            statistics.silent += 1
            problem = exc
        except ReportError as exc:
            statistics.refused += 1
            problem = exc
        if not lock_step:
            late_s = max(0.0, self.clock.now_s() - before - self.sample_time_s)
        statistics.count(late_s)
        self._lost_in_a_row = self._lost_in_a_row + 1 if problem else 0
        if problem and self._lost_in_a_row * self.sample_time_s >= TELEMETRY_TIMEOUT_S:
            self._lost_in_a_row = 0
            if isinstance(problem, ReportError):
                raise problem
            raise TelemetryTimeoutError(SILENCE) from problem
        return reading

    def _read(self) -> Telemetry:
        """The newest reading, waited for as long as TELEMETRY_TIMEOUT_S; counts the board's steps up to it.

        Raises TelemetryTimeoutError, ReportError, DisconnectedError.
        """
        transport, link = self.transport, self._link
        deadline_s = self.clock.now_s() + TELEMETRY_TIMEOUT_S
        before = transport.passed_over + link.passed_over
        self._steps += 1  # holds where nothing comes that tells more
        problem: ReportError | None = None
        while True:
            unseen = transport.passed_over
            left_s = deadline_s - self.clock.now_s()
            if left_s <= 0.0:  # a stream of garbage never ends by itself
                raise TelemetryTimeoutError(f"no good report for {1e3 * TELEMETRY_TIMEOUT_S:g} ms") from problem
            data = transport.receive(left_s)
            try:
                reading = link.receive(data, transport.passed_over - unseen)
            except ReportError as exc:
                if not transport.stream:
                    raise
                problem = exc
                continue
            finally:
                self.statistics.passed_over += transport.passed_over + link.passed_over - before
                before = transport.passed_over + link.passed_over
            if reading is not None:
                break
        if link.numbered:
            self._steps = self._steps_read + link.steps
        elif not transport.lock_step:
            self._steps += link.steps - 1
            since_s = self.clock.now_s() - self._read_s
            if since_s > GAP_S:
                self._steps = max(self._steps, self._steps_read + round(since_s / self.sample_time_s))
        self._steps_read, self._read_s = self._steps, self.clock.now_s()
        return reading

    def _count_anew(self) -> None:
        """Statistics of what follows."""
        self.statistics = TickStatistics(self.sample_time_s, real=self.clock.real)
        self._link.counts = self.statistics.link

    def _bench_time_s(self) -> float:
        """Seconds since the bench was opened, by the board's ticks where it is in lock step: for what drifts or
        warms.
        """
        if self.transport.lock_step:
            return self._steps * self.sample_time_s
        return self.clock.now_s() - self._opened_s

    def _settle(self, stop: StopSignals) -> None:
        real_line = not self.transport.lock_step
        if self.transport.lock_step and self.clock.real:
            self._due_s = self.clock.now_s()
        self._link.begin()
        quiet, last = 0, -1
        rate = cable.Rate(self.transport.name, self.profile)
        for turn in range(round(SETTLE_LIMIT_S / self.sample_time_s)):
            stop.check()
            reading = self._receive()
            if not real_line or turn >= SILENT_TICKS:
                self.transport.send(self._link.encode(BRAKE_COMMAND))
            if reading is None:
                continue
            if real_line and self.clock.real and turn >= SILENT_TICKS:
                rate.note(self._read_s, self._steps)
            quiet = quiet + 1 if reading.pos == last else 0
            last = reading.pos
            if quiet * self.sample_time_s >= REST_S and rate.is_right():
                break
        settled = "at rest" if quiet * self.sample_time_s >= REST_S else "still moving under brake"
        logger.info("%s after %.3f s at POS %d", settled, self.statistics.ticks * self.sample_time_s, last)
        self._count_anew()

    @contextmanager
    def _braked_after(self, stop: StopSignals) -> Iterator[None]:
        """Brake on the way out, whatever happens within; a board that went away is braked as soon as it is back."""
        try:
            yield
        except BaseException as exc:
            try:
                self._brake()
            except FiohostError as failed:
                exc.add_note(
                    cable.brake_when_back(
                        self.transport, self._brake, failed, self.clock, self.reconnect_s, lambda: bool(stop.requested)
                    )
                )
            raise
        self._brake()

    def _brake(self) -> None:
        """Send the brake, more than once: a line may lose or damage any report."""
        if not self.transport.lock_step:
            for _ in range(BRAKE_REPEATS):  # one a step: a target that takes them so would lag behind a heap of them
                self.transport.send(self._link.encode(BRAKE_COMMAND))
                with suppress(TelemetryTimeoutError, ReportError):
                    self._read()
            return
        # Such a board takes a command at its next step, so it needs some; by its readings it can be seen to stand.
        for _ in range(round(BRAKE_LIMIT_S / self.sample_time_s / (2 * STILL_TICKS))):
            if self._stands(BRAKE_COMMAND) and self._stands(None):
                break

    def _stands(self, command: Command | None) -> bool:
        """Whether the count stays the same for some ticks, with a command going out in each."""
        seen = set()
        for _ in range(STILL_TICKS):
            if command is not None:
                self.transport.send(self._link.encode(command))
            with suppress(TelemetryTimeoutError, ReportError):
                seen.add(self._read().pos)
        return len(seen) == 1

    def _head(self) -> dict[str, str]:
        """Metadata of every log of this bench."""
        return {
            "target": self.transport.name,
            "serial_number": self.transport.identity,
            "profile": self.profile.name,
            "run_id": self.run_id,
            "sample_time_s": f"{self.sample_time_s:.12g}",
            "command_delay_ticks": str(COMMAND_DELAY_TICKS),
            "counts_per_rev": str(self.counts_per_rev),
            "duty_steps": str(self.profile.duty_steps),
            "begins": "at rest",
            "full_scale": "100",
            "full_scale_unit": "% duty",
            "host_version": __version__,
            "start_time": datetime.now().astimezone().isoformat(timespec="seconds"),
            "limits": self.profile.limits.describe(),
            "clock": "real" if self.clock.real else "virtual",
            **self.transport.facts,
        }
