"""What a bench does differently on a real line: greet the board, know its rate, and brake it when it comes back."""

from __future__ import annotations

import logging
from collections.abc import Callable

from fiohost.bench.clock import Clock
from fiohost.errors import MotorRunningError, TelemetryTimeoutError, TransportError
from fiohost.transport.base import Transport
from fiohost.transport.profile import TargetProfile

logger = logging.getLogger("fiohost.bench")

START_LIMIT_S = 2.0  # for the first report; some boards start anew when their port is opened
LISTEN_S = 0.05
RETRY_S = 0.05
RATE_TOLERANCE = 0.25
RATE_STEPS = 100  # to be sure of a rate that looks wrong
LATE_SHARE = 0.05  # a computer that is late more often than this cannot tell the rate of a board


def greet(transport: Transport, brake: bytes, clock: Clock, profile: TargetProfile) -> None:
    """Brake what an earlier host may have left running, first of all, and wait for the board's first word.

    Raises TelemetryTimeoutError where it says nothing, after closing the line.
    """
    limit_s = max(START_LIMIT_S, profile.guards.silence_s)
    if transport.can_reopen and not profile.watchdog_s:
        logger.warning(
            "the board has no watchdog: should this computer die or the cable be pulled in mid-run, the motor runs on"
        )
    try:
        transport.send(brake)
        deadline_s = clock.now_s() + limit_s
        while True:
            try:
                transport.receive(LISTEN_S)
                return
            except TelemetryTimeoutError as exc:
                if clock.now_s() > deadline_s:
                    raise TelemetryTimeoutError(
                        f"{transport.name} is open but sends nothing for {limit_s:g} s: is the board's program "
                        "running, and is this the right port? 'fiohost sniff' shows what comes"
                    ) from exc
    except BaseException:
        transport.close()
        raise


class Rate:
    """How often reports come, against the profile's sample time.

    A board of another rate makes every time in the log wrong, and a faster host fills the buffer of a target that takes
    one packet a step.
    """

    def __init__(self, name: str, profile: TargetProfile) -> None:
        self._name, self._profile = name, profile
        self._last: tuple[float, int] | None = None
        self._doubtful = True  # the last reading: the next interval says nothing
        self._seconds, self._steps, self._late = 0.0, 0, 0
        self._owed_s = 0.0  # by so much reports may yet come too soon: what was late is made up for

    def note(self, time_s: float, step: int, *, host_was_late: bool = False, is_guess: bool = False) -> None:
        """A reading came, of that step of the board. Where this computer was late, or the step is a guess of the clock,
        neither the interval before nor the one after it says anything of the board; nor do those that follow and are
        short, until together they are as much too short as a late one was too long.
        """
        self._late += host_was_late
        doubtful = host_was_late or is_guess
        if self._last is not None:
            seconds, steps = time_s - self._last[0], step - self._last[1]
            over_s = seconds - steps * self._profile.sample_time_s
            if host_was_late or over_s < 0.0 < self._owed_s:
                self._owed_s = max(0.0, self._owed_s + over_s)
            elif not (doubtful or self._doubtful):
                self._seconds += seconds
                self._steps += steps
        self._last, self._doubtful = (time_s, step), doubtful

    def is_right(self) -> bool:
        """True also where nothing was noted; False to look longer. Raises TransportError for another rate."""
        steps = self._steps
        if steps == 0:
            return self._doubtful
        step_s, wanted_s = self._seconds / steps, self._profile.sample_time_s
        if abs(step_s / wanted_s - 1.0) <= RATE_TOLERANCE:
            return True
        if steps < RATE_STEPS or self._late > LATE_SHARE * steps:
            return False
        raise TransportError(
            f"{self._name} sends a report every {1e3 * step_s:.3g} ms, the profile {self._profile.name} says "
            f"{1e3 * wanted_s:g} ms: set sample_time_s = {step_s:.2g} in a profile of your own, or let the board send "
            "once a task step"
        )


def brake_when_back(
    transport: Transport,
    brake: Callable[[], None],
    failed: Exception,
    clock: Clock,
    limit_s: float,
    is_stopped: Callable[[], bool],
) -> str:
    """Wait for a board that went away, at most *limit_s* or until a signal, and brake it first of all.

    Gives a sentence on what came of it; *failed* is why it could not be braked before.
    """
    running = f"the brake could not be sent ({failed}): THE MOTOR MAY BE RUNNING"
    if not (limit_s and transport.can_reopen):
        return running + "; cut its power, or plug the board in and run 'fiohost manual --pwm 0'"
    logger.warning("%s; waiting for the board to come back", running)
    began_s = clock.now_s()
    while not is_stopped() and clock.now_s() - began_s < limit_s:
        try:
            transport.reopen()
            brake()
        except MotorRunningError as exc:
            return f"a board came back after {clock.now_s() - began_s:.1f} s, but {exc}"
        except Exception:  # of whatever kind: it is tried again
            clock.wait_until(clock.now_s() + RETRY_S)
        else:
            board = "the board" if transport.is_known_again else "a board"
            doubt = (
                ""
                if transport.is_known_again
                else (
                    "; it has no serial number, so that another one in its place looks the same: see that it is the one"
                )
            )
            return (
                f"{board} came back after {clock.now_s() - began_s:.1f} s and was braked first of all: "
                f"its shaft stands{doubt}"
            )
    return running + f"; it was not back after {clock.now_s() - began_s:.1f} s"
