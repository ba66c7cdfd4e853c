"""Bringing the shaft to rest: before a run, and whatever ended it."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from fiohost.bench import cable
from fiohost.bench.line import Line
from fiohost.bench.stop import StopSignals
from fiohost.bench.unwrap import Unwrapper
from fiohost.errors import DisconnectedError, MotorRunningError, ReportError, TelemetryTimeoutError
from fiohost.wire.messages import BRAKE_COMMAND, Command, Telemetry

logger = logging.getLogger("fiohost.bench")

REST_S = 0.1  # at rest: no count for this long
SETTLE_LIMIT_S = 5.0
STILL_TICKS = 5  # a simulated shaft is believed to stand after this many equal readings, and as many in silence
BRAKE_LIMIT_S = 1.0
STAND_COUNTS = 1  # a sensor on an edge may go to and fro by one count at rest
STAND_LIMIT_S = 2.0  # for a braked shaft on a real line to come to rest, in ticks
SILENCE_LIMIT_S = 0.5  # without any reading: nobody will say whether it stands
SILENT_TICKS = 3  # a target that takes one packet a step works off what is under way before it is sent more

CUT = "cut its power, or plug the board in anew and run 'fiohost manual --pwm 0'"


class Shaft:
    """What the last readings say of the shaft's motion, over REST_S of them."""

    def __init__(self, line: Line) -> None:
        sample_time_s = line.profile.sample_time_s
        self._deg = 360.0 / line.profile.counts_per_rev
        self._tick_s = sample_time_s
        self._unwrap = Unwrapper(line.profile.counts_per_rev).update
        self._seen: deque[tuple[int, int]] = deque(maxlen=max(2, round(REST_S / sample_time_s) + 1))

    def note(self, step: int, pos: int) -> None:
        self._seen.append((step, self._unwrap(pos)))

    @property
    def stands(self) -> bool:
        """Whether it has not moved in all readings of the last REST_S."""
        counts = [count for _, count in self._seen]
        return self.is_known and max(counts) - min(counts) <= STAND_COUNTS

    @property
    def is_known(self) -> bool:
        return len(self._seen) == self._seen.maxlen

    @property
    def speed_deg_s(self) -> float:
        """Over the last readings; 0 where there are none."""
        if len(self._seen) < 2:
            return 0.0
        (first, begin), (last, end) = self._seen[0], self._seen[-1]
        return (end - begin) * self._deg / (max(1, last - first) * self._tick_s)


def settle(line: Line, stop: StopSignals) -> bool:
    """Brake until the shaft is at rest, at most for SETTLE_LIMIT_S: whether it came to rest. Meanwhile the board's rate
    is looked at.

    Raises Stopped on a signal, MotorRunningError for a board that does not brake, TransportError for one of another
    rate, and what :meth:`Line.tick` raises.
    """
    sample_time_s, real_line = line.profile.sample_time_s, not line.transport.lock_step
    line.begin()
    line.count_anew()
    at_rest, quiet, last, shaft = False, 0, -1, Shaft(line)
    rate = cable.Rate(line.transport.name, line.profile)
    for turn in range(round(SETTLE_LIMIT_S / sample_time_s)):
        stop.check()
        reading = line.tick()
        if not real_line or turn >= SILENT_TICKS:
            line.send(BRAKE_COMMAND)
        if reading is None:
            continue
        if real_line and line.clock.real and turn >= SILENT_TICKS:
            rate.note(line.read_s, line.steps, host_was_late=line.host_was_late, is_guess=line.steps_are_a_guess)
        shaft.note(line.steps, reading.pos)
        quiet = quiet + 1 if reading.pos == last else 0
        last = reading.pos
        at_rest = quiet * sample_time_s >= REST_S
        if at_rest and rate.is_right():
            break
    if line.transport.can_reopen and not at_rest and not _is_slow(line, shaft):
        raise MotorRunningError(
            f"the brake was sent for {SETTLE_LIMIT_S:g} s before the run, and {_turning(shaft)}: THE MOTOR MAY BE "
            f"RUNNING; the board ignores commands, or a load turns it; nothing was driven: {CUT}"
        )
    said = "at rest" if at_rest else "still moving under brake"
    logger.info("%s after %.3f s at POS %d", said, line.statistics.ticks * sample_time_s, last)
    line.count_anew()
    return at_rest


@contextmanager
def braked_after(line: Line, stop: StopSignals, reconnect_s: float) -> Iterator[None]:
    """Brake on the way out, whatever happens within; a board that went away is braked as soon as it is back.

    Raises MotorRunningError where the shaft does not come to rest.
    """
    try:
        yield
    except BaseException as exc:
        try:
            brake(line)
        except MotorRunningError as failed:
            exc.add_note(str(failed))
        except Exception as failed:  # of whatever kind: it must not hide that the motor may be running
            if line.guardian is not None:
                # It may still reach the board. Then it goes: a copy of a dead line keeps the board's name taken.
                line.guardian.close(braked=False)
                line.guardian = None
            exc.add_note(
                cable.brake_when_back(
                    line.transport, lambda: brake(line), failed, line.clock, reconnect_s, lambda: bool(stop.requested)
                )
            )
        raise
    brake(line)


def brake(line: Line) -> None:
    """Send the brake until the readings say that the shaft stands. Raises TransportError; on a real line
    MotorRunningError where they do not say so.
    """
    if line.transport.lock_step:
        # Such a board takes a command at its next step, so it needs some; by its readings it can be seen to stand.
        for _ in range(round(BRAKE_LIMIT_S / line.profile.sample_time_s / (2 * STILL_TICKS))):
            if _stands(line, BRAKE_COMMAND) and _stands(line, None):
                break
        return
    shaft, heard_s = Shaft(line), line.clock.now_s()
    for _ in range(round(STAND_LIMIT_S / line.profile.sample_time_s)):
        line.send(BRAKE_COMMAND)  # one a step: a target that takes them so would lag behind a heap of them
        reading = _listen(line)
        if reading is not None:
            heard_s = line.clock.now_s()
            shaft.note(line.steps, reading.pos)
        if shaft.stands or line.clock.now_s() - heard_s > SILENCE_LIMIT_S:
            break
    if shaft.stands or not line.transport.can_reopen:  # a recorded trace hears no brake
        return
    if shaft.is_known and _is_slow(line, shaft):
        logger.warning("braked, and %s: a load does that", _turning(shaft))
        return
    what = _turning(shaft) if shaft.is_known else "no reading says that the shaft stands"
    raise MotorRunningError(
        f"the brake was sent, but {what}: THE MOTOR MAY BE RUNNING; the board ignores commands, or cannot be heard: "
        f"{CUT}"
    )


def _is_slow(line: Line, shaft: Shaft) -> bool:
    """Whether a braked shaft moves no faster than a load may turn it."""
    return abs(shaft.speed_deg_s) <= line.profile.guards.braked_deg_s


def _turning(shaft: Shaft) -> str:
    return f"the shaft still turns at {shaft.speed_deg_s:.0f} deg/s"


def _stands(line: Line, command: Command | None) -> bool:
    """Whether the count stays the same for some ticks, with a command going out in each."""
    seen = set()
    for _ in range(STILL_TICKS):
        if command is not None:
            line.send(command)
        reading = _listen(line)
        if reading is not None:
            seen.add(reading.pos)
    return len(seen) == 1


def _listen(line: Line) -> Telemetry | None:
    """The newest reading, where there is one: brakes go out one a step, whatever is the matter with reading.

    Raises DisconnectedError.
    """
    try:
        return line.newest()
    except DisconnectedError:
        raise
    except (TelemetryTimeoutError, ReportError):
        return None
    except Exception as exc:
        logger.info("braking without readings: %s: %s", type(exc).__name__, exc)
        line.clock.wait_until(line.clock.now_s() + line.profile.sample_time_s)
        return None
