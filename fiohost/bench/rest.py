"""Bringing the shaft to rest: before a run, and whatever ended it."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from fiohost.bench import cable
from fiohost.bench.line import Line
from fiohost.bench.stop import StopSignals
from fiohost.errors import DisconnectedError, ReportError, TelemetryTimeoutError
from fiohost.wire.messages import BRAKE_COMMAND, Command, Telemetry

logger = logging.getLogger("fiohost.bench")

REST_S = 0.1  # at rest: no count for this long
SETTLE_LIMIT_S = 5.0
BRAKE_REPEATS = 5  # a brake may be lost on its way, and nobody else would send another
STILL_TICKS = 5  # a braked shaft is believed to stand after this many equal readings, and as many in silence
BRAKE_LIMIT_S = 1.0
SILENT_TICKS = 3  # a target that takes one packet a step works off what is under way before it is sent more


def settle(line: Line, stop: StopSignals) -> bool:
    """Brake until the shaft is at rest, at most for SETTLE_LIMIT_S: whether it came to rest. Meanwhile the board's rate
    is looked at.

    Raises Stopped on a signal, TransportError for a board of another rate, and what :meth:`Line.tick` raises.
    """
    sample_time_s, real_line = line.profile.sample_time_s, not line.transport.lock_step
    line.begin()
    quiet, last = 0, -1
    rate = cable.Rate(line.transport.name, line.profile)
    for turn in range(round(SETTLE_LIMIT_S / sample_time_s)):
        stop.check()
        reading = line.tick()
        if not real_line or turn >= SILENT_TICKS:
            line.send(BRAKE_COMMAND)
        if reading is None:
            continue
        if real_line and line.clock.real and turn >= SILENT_TICKS:
            rate.note(line.read_s, line.steps)
        quiet = quiet + 1 if reading.pos == last else 0
        last = reading.pos
        if quiet * sample_time_s >= REST_S and rate.is_right():
            break
    at_rest = quiet * sample_time_s >= REST_S
    said = "at rest" if at_rest else "still moving under brake"
    logger.info("%s after %.3f s at POS %d", said, line.statistics.ticks * sample_time_s, last)
    line.count_anew()
    return at_rest


@contextmanager
def braked_after(line: Line, stop: StopSignals, reconnect_s: float) -> Iterator[None]:
    """Brake on the way out, whatever happens within; a board that went away is braked as soon as it is back."""
    try:
        yield
    except BaseException as exc:
        try:
            brake(line)
        except Exception as failed:  # of whatever kind: it must not hide that the motor may be running
            exc.add_note(
                cable.brake_when_back(
                    line.transport, lambda: brake(line), failed, line.clock, reconnect_s, lambda: bool(stop.requested)
                )
            )
        raise
    brake(line)


def brake(line: Line) -> None:
    """Send the brake, more than once: a line may lose or damage any report. Raises TransportError."""
    if not line.transport.lock_step:
        for _ in range(BRAKE_REPEATS):  # one a step: a target that takes them so would lag behind a heap of them
            line.send(BRAKE_COMMAND)
            _listen(line)
        return
    # Such a board takes a command at its next step, so it needs some; by its readings it can be seen to stand.
    for _ in range(round(BRAKE_LIMIT_S / line.profile.sample_time_s / (2 * STILL_TICKS))):
        if _stands(line, BRAKE_COMMAND) and _stands(line, None):
            break


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
