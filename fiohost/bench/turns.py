"""The turns of a run: take telemetry k, ask the program, send command k, write both down.

Where telemetry k is missing nothing is sent: the board holds its outputs, the log has no row. What stands between a
reading and its answer is kept short; all that can wait comes after it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from fiohost.bench.guard import MotorGuard
from fiohost.bench.host import HostWatch
from fiohost.bench.limits import Limiter
from fiohost.bench.line import Line
from fiohost.bench.program import Program
from fiohost.bench.stop import StopSignals
from fiohost.bench.unwrap import Unwrapper
from fiohost.bench.writer import LogWriter
from fiohost.wire.messages import Command


class Tick(NamedTuple):
    """One turn of the loop, for those who watch."""

    time_s: float
    command: Command
    pos: int
    direction: int
    angle_deg: float  # unwrapped, POS/2
    ref_deg: float | None


Progress = Callable[[Tick], None]


def turns(
    line: Line, program: Program, writer: LogWriter, stop: StopSignals, progress: Progress | None, every: int
) -> None:
    """Turn until the program ends. *progress* is told each *every* ticks.

    Raises Stopped, FiohostError, and whatever the program and *progress* raise.
    """
    profile, clock = line.profile, line.clock
    step, send, encode, row, tick = program.step, line.transport.send, line.link.encode, writer.row, line.tick
    watch = HostWatch(line)
    unwrap = Unwrapper(profile.counts_per_rev).update
    deg, sample_time_s = 360.0 / profile.counts_per_rev, profile.sample_time_s
    guard = MotorGuard(profile.guards, sample_time_s, profile.counts_per_rev, getattr(program, "patience", 1.0)).check
    limiter, carried = Limiter(profile.limits, sample_time_s), line.link.codec.carried
    real, begin, shown = clock.real, 0.0, -every
    first: int | None = None  # a program's time begins with its first reading, however late that comes
    with watch.alarmed():
        while True:
            if stop.requested:
                stop.check()
            reading = tick()
            if reading is None:
                watch.turn()
                continue
            if first is None:
                first, begin = line.steps, clock.now_s() if real else 0.0
            k = line.steps - first
            direction, pos, _, _ = reading
            angle = unwrap(pos) * deg
            answer = step(k, angle)
            watch.turn()  # as near as can be before what is sent
            if answer is None:
                return
            command, ref = answer
            time_s = k * sample_time_s
            command = carried(limiter.allow(command, angle, time_s))
            guard(k, command, angle)
            send(encode(command))
            host = clock.now_s() - begin if real else None
            line.statistics.slowed = limiter.slowed
            row(time_s, command.duty_pct, command.c3, command.c4, pos, direction, ref, angle, host)
            if progress is not None and k // every != shown:
                shown = k // every
                progress(Tick(time_s, command, pos, direction, angle, ref))
