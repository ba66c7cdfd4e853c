"""The bench: programs run on a board, with a safe stop and a log.

Whatever ends a run (its program, Ctrl-C, a signal, an exception in a controller, 50 ms without a good report, a full
disk), the board is braked first; then the log is closed, complete.
"""

from __future__ import annotations

import logging
import secrets
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from datetime import datetime
from types import TracebackType
from typing import Self

from fiohost import __version__
from fiohost.bench import cable
from fiohost.bench.clock import Clock, MonotonicClock, VirtualClock
from fiohost.bench.experiment import Experiment
from fiohost.bench.guardian import Guardian
from fiohost.bench.hand import Hand, command_of
from fiohost.bench.line import Line
from fiohost.bench.log import Log, LogWriter
from fiohost.bench.program import Hold, Program
from fiohost.bench.rest import brake, braked_after, settle
from fiohost.bench.statistics import TickStatistics
from fiohost.bench.stop import Stopped, StopSignals
from fiohost.bench.turns import Progress, Tick, turns
from fiohost.bench.watcher import Watcher, quick_switches
from fiohost.bench.writer import NoLog
from fiohost.errors import ConfigError, HostError, LogError
from fiohost.files import Output
from fiohost.transport.base import Transport, Way
from fiohost.transport.profile import TargetProfile
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

__all__ = ["COMMAND_DELAY_TICKS", "Bench", "Progress", "Tick"]

logger = logging.getLogger("fiohost.bench")

FEW_LATE = 5  # ticks: so few are no share
COMMAND_DELAY_TICKS = 1  # the board latches the answer to telemetry k at step k+1


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
        self.reconnect_s = reconnect_s
        self.profile = profile = profile.with_counts(transport.counts_per_rev)
        self.sample_time_s = profile.sample_time_s
        self.counts_per_rev = profile.counts_per_rev
        self.clock = clock or (VirtualClock() if transport.lock_step else MonotonicClock())
        self.run_id = run_id or secrets.token_hex(8)  # of all logs of this bench; random, made from nothing
        self._line = Line(transport, profile, self.clock)
        self._opened_s = self.clock.now_s()
        transport.open()
        if not transport.lock_step:
            cable.greet(transport, self._line.link.encode(BRAKE_COMMAND), self.clock, profile)
        self._guardian: Guardian | None = None
        self._guarded: Way | None = None
        self._by_hand: Hand | None = None
        try:
            self._set_guardian()
        except BaseException:
            transport.close()
            raise
        layout = f"{profile.name} (layout {profile.status})"
        logger.info("opened %s: %s, profile %s, run %s", transport.name, transport.identity, layout, self.run_id)

    @property
    def transport(self) -> Transport:
        return self._line.transport

    @transport.setter
    def transport(self, transport: Transport) -> None:
        """Another way to the same board, such as one that times it."""
        self._line.transport = transport

    @property
    def statistics(self) -> TickStatistics:
        """Of the run that goes on, or of the last one."""
        return self._line.statistics

    # ---- for users: by statements -------------------------------------------------------------------------------

    @property
    def duty(self) -> float | None:
        """Duty in percent of full scale, -100 to 100, 0 brakes; setting None is standby. It holds until it is set
        again, at most HOLD_S after the last statement on a real board. Raises LimitError.
        """
        return self._hand.duty

    @duty.setter
    def duty(self, value: float | None) -> None:
        command = command_of(value)
        self._hand.drive(command)

    @property
    def ref_deg(self) -> float:
        """Reference that is written to the log, in degrees; NaN: none."""
        return self._hand.ref_deg

    @ref_deg.setter
    def ref_deg(self, value: float) -> None:
        self._hand.ref_deg = value

    @property
    def angle_deg(self) -> float:
        """The newest angle in degrees; it does not jump after a turn."""
        return self._hand.angle_deg

    @property
    def speed_deg_s(self) -> float:
        """The mean speed over the last ticks, degrees a second."""
        return self._hand.speed_deg_s

    @property
    def time_s(self) -> float:
        """Seconds since the first statement, by the board's ticks."""
        return self._hand.time_s

    def sleep(self, seconds: float | None = None) -> None:
        """Let *seconds* pass, or one tick, while the duty holds. Simulated boards take no time for it.

        Raises FiohostError where something failed meanwhile; the motor is braked then.
        """
        self._hand.sleep(seconds)

    @property
    def log(self) -> Log:
        """What was measured since the first statement. Raises DataError where there is nothing yet."""
        return self._hand.log(self.head())

    @property
    def _hand(self) -> Hand:
        if self._by_hand is None:
            self._by_hand = Hand(self)
        return self._by_hand

    def _end_statements(self) -> None:
        """Brake and end driving by statements, where that goes on."""
        hand, self._by_hand = self._by_hand, None
        if hand is not None:
            hand.close()

    # ---- for users: runs ----------------------------------------------------------------------------------------

    def run(
        self,
        experiment: Experiment | str,
        log_path: Output | None = None,
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
        log_path: Output | None = None,
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
        log_path: Output | None = None,
        metadata: Mapping[str, str] | None = None,
        progress: Progress | None = None,
        progress_every_s: float = 0.1,
    ) -> Log:
        """Run any program from rest until it ends, then brake. The log is opened before anything moves."""
        self._end_statements()
        writer = LogWriter(
            log_path, {**self.head(), **(metadata or {})}, host_time=self.clock.real, behind=self._is_apart
        )
        self._record(program, writer, progress, progress_every_s)
        return Log.read(writer.path) if writer.path is not None else Log.parse(writer.text())

    def live(
        self,
        program: Program,
        log_path: Output | None = None,
        metadata: Mapping[str, str] | None = None,
        progress: Progress | None = None,
        progress_every_s: float = 0.1,
        also: Callable[..., None] | None = None,
    ) -> int:
        """As :meth:`play`, for sessions of any length: without *log_path* rows are counted, not kept. Gives rows.

        *also* is given every row, as :meth:`fiohost.bench.writer.LogWriter.row` is.
        """
        kind = NoLog if log_path is None else LogWriter
        writer = kind(log_path, {**self.head(), **(metadata or {})}, host_time=self.clock.real, behind=self._is_apart)
        writer.also = also
        self._record(program, writer, progress, progress_every_s)
        return writer.rows

    def _record(self, program: Program, writer: LogWriter, progress: Progress | None, progress_every_s: float) -> None:
        line = self._line
        line.count_anew()
        watcher = Watcher(progress) if progress is not None and self._is_apart else None
        try:
            with (
                StopSignals() as stop,
                stop.hang_ups(),
                quick_switches(self._is_apart),
                ExitStack() as until_braked,
                braked_after(line, stop, self.reconnect_s),
            ):
                self._set_guardian()
                at_rest = settle(line, stop)
                every = max(1, round(progress_every_s / self.sample_time_s))
                writer.begin(self._bench_time_s(), at_rest)
                if self._guardian is not None:
                    until_braked.enter_context(self._guardian.on_duty())
                with stop.interruptible():
                    turns(line, program, writer, stop, watcher or progress, every)
            stop.check()  # a signal during the last brake is an end by signal too
        except BaseException as exc:
            self._close(writer, exc)
            if watcher is not None:
                watcher.leave()
            raise
        writer.close("complete", self.statistics.describe())
        if watcher is not None:
            watcher.close()
        self._judge_host(writer)

    def _judge_host(self, writer: LogWriter) -> None:
        """Raise HostError where too many ticks were late or missing because of this computer."""
        late, guards = self.statistics.host_late, self.profile.guards
        ticks = self.statistics.ticks + self.statistics.passed_over
        if not self.transport.can_reopen or late < FEW_LATE or 100.0 * late <= guards.late_pct * ticks:
            return
        error = HostError(
            f"{late} of {ticks} ticks ({100.0 * late / ticks:.1f} %) were missed or answered late because this "
            f"computer was busy, more than guards.late_pct = {guards.late_pct:g}: the run is complete, but not in real "
            "time; end other programs, or try --realtime-priority"
        )
        if writer.path is not None:
            error.add_note(f"the log {writer.path} is closed with its {writer.rows} rows")
        raise error

    @property
    def _is_apart(self) -> bool:
        """Whether what may wait is done apart from the loop: the board does not wait for its host."""
        return not self.transport.lock_step

    def _set_guardian(self) -> None:
        """A guardian for the line as it is open now. Raises HostError."""
        way = self.transport.way
        if way == self._guarded and (way is None or self._line.guardian is not None):
            return
        if self._guardian is not None:
            self._guardian.close()
            self._guardian = None
        self._guardian = self._line.guardian = Guardian.of(self.transport, self.profile)
        self._guarded = way

    def _close(self, writer: LogWriter, exc: BaseException) -> None:
        """Close the log of a run that *exc* ended, and tell *exc* what it holds."""
        try:
            writer.close(
                str(exc) if isinstance(exc, Stopped) else f"stopped: {type(exc).__name__}: {exc}",
                self.statistics.describe(),
            )
            if writer.path is not None:
                exc.add_note(f"the log {writer.path} is closed with its {writer.rows} rows")
        except LogError as failed:
            exc.add_note(str(failed))

    def settle(self) -> None:
        """Brake until the shaft is at rest (no count for 0.1 s), at most for 5 s."""
        self._end_statements()
        with StopSignals() as stop, braked_after(self._line, stop, self.reconnect_s):
            settle(self._line, stop)

    def close(self) -> None:
        """Brake and give the line back; harmless when done twice. A signal meanwhile is heard afterwards."""
        self._end_statements()
        with StopSignals() as stop:
            braked = False
            try:
                brake(self._line)
                braked = True
            finally:
                if self._guardian is not None:
                    self._guardian.close(braked=braked)
                    self._guardian = self._line.guardian = self._guarded = None
                self.transport.close()
        stop.check()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except Exception:  # what ended the run is told, not what became of the line since
            if value is None:
                raise

    # ---- what a log says of it ------------------------------------------------------------------------------------

    def _bench_time_s(self) -> float:
        """Seconds since the bench was opened, by the board's ticks where it is in lock step: for what drifts or
        warms.
        """
        if self.transport.lock_step:
            return self._line.steps * self.sample_time_s
        return self.clock.now_s() - self._opened_s

    def head(self) -> dict[str, str]:
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
            "full_scale": "100",
            "full_scale_unit": "% duty",
            "host_version": __version__,
            "start_time": datetime.now().astimezone().isoformat(timespec="seconds"),
            "limits": self.profile.limits.describe(),
            "clock": "real" if self.clock.real else "virtual",
            **self.transport.facts,
        }
