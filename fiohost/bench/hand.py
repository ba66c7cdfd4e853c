"""Driving by statements: ``bench.duty = 40; bench.sleep(1); bench.angle_deg``.

The tick loop runs in a thread of its own, with every guard of a run. A board in lock step waits for its host, so there
time passes in ``sleep`` alone; a real board's time goes on, and its duty is taken back when the program that set it
does not come again for HOLD_S. Whatever ends the session brakes.
"""

from __future__ import annotations

import atexit
import math
import threading
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from time import monotonic
from typing import TYPE_CHECKING

from fiohost.bench.log import Log
from fiohost.bench.program import Answer
from fiohost.bench.turns import Tick
from fiohost.errors import ConfigError, DataError
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

if TYPE_CHECKING:
    from fiohost.bench.loop import Bench

HOLD_S = 2.0  # a real motor is driven on for so long after the last statement
SPEED_TICKS = 4  # over which the speed is taken
LONGEST_S = 86_400.0
MOST_ROWS = 5_000_000  # kept of a session, some 7 hours at 5 ms


class Hand:
    """One session of driving by statements on a bench, from its first statement until it is closed."""

    def __init__(self, bench: Bench) -> None:
        self._bench = weakref.ref(bench)
        self._tick_s = bench.sample_time_s
        self._paced = bench.transport.lock_step and not bench.clock.real  # whether the board waits for statements
        self._change = threading.Condition()
        self._command, self._ref_deg = BRAKE_COMMAND, math.nan
        self._budget = 0  # ticks that a paced board may go on
        self._tick: int  # of the newest reading
        self._began = self._waits = self._ends = False
        self._angles: deque[tuple[int, float]] = deque(maxlen=SPEED_TICKS + 1)
        self._rows: list[Tick] = []
        self._touched_s = monotonic()
        self._asleep = False
        self._problem: BaseException | None = None
        self._thread = threading.Thread(target=self._drive, args=(bench,), name="fiohost bench", daemon=True)
        self._thread.start()
        atexit.register(self.close)
        self._wait(lambda: self._began)

    # ---- statements -------------------------------------------------------------------------------------------------

    @property
    def duty(self) -> float:
        """The duty that is sent, percent of full scale."""
        self._touch()
        return self._command.duty_pct

    def drive(self, command: Command) -> None:
        with self._change:
            self._touch()
            self._command = command

    @property
    def ref_deg(self) -> float:
        return self._ref_deg

    @ref_deg.setter
    def ref_deg(self, value: float) -> None:
        self._touch()
        self._ref_deg = float(value)

    @property
    def angle_deg(self) -> float:
        self._touch()
        with self._change:
            return self._angles[-1][1]

    @property
    def speed_deg_s(self) -> float:
        """The mean speed over the last SPEED_TICKS ticks; 0 before there are so many."""
        self._touch()
        with self._change:
            (first, begin), (last, end) = self._angles[0], self._angles[-1]
        return (end - begin) / ((last - first) * self._tick_s) if last > first else 0.0

    @property
    def time_s(self) -> float:
        """Seconds since the session began, by the board's ticks."""
        self._touch()
        return self._tick * self._tick_s

    def sleep(self, seconds: float | None) -> None:
        """Let time pass: *seconds*, or one tick. Raises what ended the session, and Stopped on Ctrl-C."""
        if seconds is None:
            ticks = 1
        elif 0.0 <= seconds <= LONGEST_S:
            ticks = round(seconds / self._tick_s)
        else:
            raise ConfigError(f"a sleep of {seconds!r} s is not within 0 to {LONGEST_S:g} s")
        with self._change:
            until = self._tick + ticks
            self._asleep = True
            if self._paced and ticks:
                self._budget += ticks
                self._waits = False
                self._change.notify_all()
        try:
            self._wait(lambda: self._waits if self._paced else self._tick >= until)
        finally:
            self._asleep = False
            self._touch()

    def log(self, head: Mapping[str, str]) -> Log:
        """What was measured until now. Raises DataError before the first tick."""
        rows = list(self._rows)
        if not rows:
            raise DataError("nothing was measured yet: set a duty and sleep")
        columns = {
            "time_s": [row.time_s for row in rows],
            "duty_pct": [row.command.duty_pct for row in rows],
            "c3": [row.command.c3 for row in rows],
            "c4": [row.command.c4 for row in rows],
            "pos": [row.pos for row in rows],
            "direction": [row.direction for row in rows],
            "ref_deg": [math.nan if row.ref_deg is None else row.ref_deg for row in rows],
            "angle_deg": [row.angle_deg for row in rows],
        }
        return Log.from_columns(columns, {**head, "experiment": "statements"}, "(session)")

    def close(self) -> None:
        """Brake and end; harmless when done twice. What ended the session before is not told again."""
        with self._change:
            self._ends = True
            self._change.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()
        atexit.unregister(self.close)

    # ---- the loop's side --------------------------------------------------------------------------------------------

    def _drive(self, bench: Bench) -> None:
        try:
            bench.live(self, progress=self._note, progress_every_s=0.0)
        except BaseException as exc:
            self._problem = exc
        finally:
            with self._change:
                self._ends = self._began = True
                self._change.notify_all()

    def step(self, k: int, angle_deg: float) -> Answer | None:
        """The command for this reading (see :class:`fiohost.bench.program.Program`)."""
        with self._change:
            self._tick, self._began = k, True
            self._angles.append((k, angle_deg))
            if self._paced:
                if self._budget <= 0:
                    self._waits = True
                self._change.notify_all()
                while self._budget <= 0 and not self._ends:
                    self._change.wait()
                self._budget -= 1
            else:
                self._change.notify_all()
                if not self._asleep and monotonic() - self._touched_s > HOLD_S:
                    self._command = BRAKE_COMMAND
            if self._ends:
                return None
            return self._command, None if math.isnan(self._ref_deg) else self._ref_deg

    def _note(self, tick: Tick) -> None:
        if len(self._rows) < MOST_ROWS:
            self._rows.append(tick)

    def _touch(self) -> None:
        self._touched_s = monotonic()
        if self._problem is not None:
            raise self._problem
        if self._ends:
            raise ConfigError("the bench is closed: connect anew")

    def _wait(self, done: Callable[[], bool]) -> None:
        with self._change:
            while not done() and not self._ends:
                self._change.wait(0.2)  # so that Ctrl-C is heard
        if self._problem is not None:
            raise self._problem


def command_of(duty: float | None) -> Command:
    """The command of a duty; None is standby. Raises LimitError."""
    return STANDBY_COMMAND if duty is None else Command.drive(float(duty))
