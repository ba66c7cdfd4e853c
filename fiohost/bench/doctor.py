"""What can be found out about a bench: how well its line keeps time, and, where it may move, its signs.

Findings are sentences with a cure. Without permission to move the motor is braked all the time.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from fiohost.bench.loop import Bench
from fiohost.bench.program import Answer, Hold
from fiohost.errors import TelemetryTimeoutError
from fiohost.transport.timed import TimedTransport
from fiohost.wire.identity import QUERY, Identity, find_identity
from fiohost.wire.messages import BRAKE_COMMAND

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from fiohost.bench.log import Log

LISTEN_S = 2.0
SLOW_SHARE = 0.5  # of a tick: an answer that takes longer may miss the board's next step
LATE_SHARE = 0.02  # of ticks whose answer may be so late before it is a problem
PULSE_S = 0.2
PULSES_PCT = (5.0, 10.0, 15.0, 20.0, 30.0, 40.0)
MOVED_COUNTS = 6
QUERY_HEADER = bytes.fromhex("a5 5a")  # of the layouts whose boards may know the query
OK, NOTE, PROBLEM = "ok", "note", "problem"
ASKED_TIMES, PIECES = 3, 20  # a query may be lost; so many pieces of the stream are heard for its answer


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at. ``cure`` is what to do about it."""

    level: str
    what: str
    cure: str = ""


@dataclass
class Timing:
    """Milliseconds: from report to report, and from a report's arrival until the answer was handed over."""

    interval_ms: NDArray[np.float64]
    answer_ms: NDArray[np.float64]
    sample_time_ms: float
    findings: list[Finding] = field(default_factory=list)

    @property
    def achievable_hz(self) -> float:
        """Ticks a second that the host could keep here: one answer of twenty may take longer."""
        return float(1e3 / max(np.percentile(self.answer_ms, 95.0), 1e-3))


def identity(bench: Bench) -> Identity | None:
    """Who the board is, asked over the wire; None where its layout has no query, or where it does not answer.

    Nothing is driven. Raises TransportError, DisconnectedError.
    """
    layout, line = bench.profile.codec.command_layout, bench.transport
    if not line.stream or layout.header != QUERY_HEADER or layout.crc is None:
        return None
    for _ in range(ASKED_TIMES):
        heard = b""
        line.send(QUERY)
        for _ in range(PIECES):
            with suppress(TelemetryTimeoutError):
                heard += line.receive(bench.sample_time_s)
            if (found := find_identity(heard)) is not None:
                return found
    return None


def who(bench: Bench) -> Iterator[Finding]:
    """What the board says of itself, against its profile. Raises as :func:`identity`."""
    profile, found = bench.profile, identity(bench)
    if found is None:
        if profile.board:
            cure = f"'fiohost firmware flash {profile.board}' puts the firmware on it that does"
            yield Finding(PROBLEM, f"the board does not say who it is; the profile is of {profile.board!r}", cure)
        return
    yield Finding(OK, found.describe())
    if profile.board not in ("", found.name):
        cure = f"use the profile of this board: --target {found.name}:PORT"
        yield Finding(PROBLEM, f"the profile {profile.name} is of {profile.board!r}, the board is {found.name!r}", cure)
    pairs = (
        ("duty_steps", profile.duty_steps, found.duty_steps),
        ("watchdog_s", profile.watchdog_s, found.watchdog_s),
        ("counts_per_rev", profile.counts_per_rev, found.counts_per_rev),
        ("sample_time_s", profile.sample_time_s, found.sample_time_s),
    )
    for key, said, true in pairs:
        if abs(said - true) > 1e-9 and not (key == "duty_steps" and not said):
            cure = f"write {key} = {true:g} into a profile of your own, or use --target {found.name}:PORT"
            yield Finding(PROBLEM, f"the profile says {key} = {said:g}, the board {true:g}", cure)
    if found.refused_frames:
        cure = "a few come when a port opens; a number that grows is a bad cable, or another baud rate"
        yield Finding(NOTE, f"the board has refused {found.refused_frames} damaged frames since its reset", cure)
    if found.bad_edges:
        cure = "counts are lost: noise on the encoder's wires, or a shaft faster than the board can follow"
        yield Finding(PROBLEM, f"both encoder levels changed at once {found.bad_edges} times since the reset", cure)


def timing(bench: Bench, seconds: float = LISTEN_S) -> Timing:
    """Listen and answer with the brake for some *seconds*, within the target's run time. Raises FiohostError as every
    run does.
    """
    seconds = min(seconds, bench.profile.limits.run_time_s)
    line = bench.transport
    timed = TimedTransport(line, time.perf_counter)
    bench.transport = timed
    try:
        program = _Braked(timed, max(20, round(seconds / bench.sample_time_s)))
        bench.play(program)
    finally:
        bench.transport = line
    received, sent = np.array(program.received_s), np.array(program.answered_s)
    tick_ms = 1e3 * bench.sample_time_s
    found = Timing(1e3 * np.diff(received), 1e3 * sent, tick_ms)
    say = found.findings
    median = float(np.median(found.interval_ms))
    paced = not bench.transport.lock_step or bench.clock.real
    if paced and abs(median / tick_ms - 1.0) > 0.1:
        say.append(
            Finding(
                PROBLEM,
                f"reports come every {median:.2f} ms, the profile says {tick_ms:g} ms",
                f"set sample_time_s = {1e-3 * median:.4f} in a profile of your own; fast pairs and long gaps in turn "
                "are an adapter that waits (FTDI: low latency was asked for, 16 ms without it)",
            )
        )
    elif paced:
        say.append(Finding(OK, f"reports come every {median:.2f} ms, as the profile says"))
    late = float(np.mean(found.answer_ms > SLOW_SHARE * tick_ms))
    if late > LATE_SHARE:
        say.append(
            Finding(
                PROBLEM,
                f"{100 * late:.1f} % of the answers took longer than half a tick",
                "end other programs, use no USB hub or virtual machine, on a laptop plug in the power; a run goes on, "
                "but commands may act a tick later than the log says",
            )
        )
    else:
        say.append(Finding(OK, f"answers are on their way within {np.percentile(found.answer_ms, 99):.2f} ms (99 %)"))
    statistics = bench.statistics
    lost = statistics.link.lost + statistics.refused + statistics.silent
    if lost:
        say.append(
            Finding(
                PROBLEM,
                f"{lost} of {statistics.ticks} reports were lost or damaged: {statistics.describe()}",
                "a shorter or better cable, away from the motor's wires; 'fiohost sniff' shows what comes",
            )
        )
    return found


class _Braked(Hold):
    """Brakes, and keeps what was noted while it did: not the settling before, nor the last brake."""

    def __init__(self, timed: TimedTransport, ticks: int) -> None:
        super().__init__(BRAKE_COMMAND, ticks)
        self._timed = timed
        self._began: tuple[int, int] | None = None
        self.received_s: list[float] = []
        self.answered_s: list[float] = []

    def step(self, k: int, angle_deg: float) -> Answer | None:
        timed = self._timed
        if self._began is None:
            self._began = len(timed.received_s) - 1, len(timed.answered_s)
        answer = super().step(k, angle_deg)
        if answer is None:
            self.received_s = timed.received_s[self._began[0] :]
            self.answered_s = timed.answered_s[self._began[1] :]
        return answer


def signs(bench: Bench, most_pct: float) -> Iterator[Finding]:
    """Short pulses of rising duty in both directions, until the shaft moves a little; what they say of the wiring.

    Raises FiohostError as every run does, LimitError where the profile forbids the duty.
    """
    forward, at_forward = _first_move(bench, 1, most_pct)
    reverse, at_reverse = _first_move(bench, -1, most_pct)
    if forward is None and reverse is None:
        reached_pct = min(at_forward, at_reverse)
        slewed = "the target's slew limit lets a short pulse reach no more; " if bench.statistics.slowed else ""
        yield Finding(
            PROBLEM,
            f"the shaft does not move within {reached_pct:g} % of duty, in either direction",
            f"{slewed}is the motor's supply on, are C3 and C4 pulled up (without, the motor coasts in every setting), "
            "is the encoder connected? Much friction, or a bridge in fast decay: --most 100 tries harder",
        )
        return
    if forward is None or reverse is None:
        dead, bit = ("forward", "C3") if forward is None else ("in reverse", "C4")
        yield Finding(
            PROBLEM,
            f"the shaft does not move {dead} within {at_forward if forward is None else at_reverse:g} %",
            f"{bit} does not reach the bridge as 1 while the other is 0: check its wire and pull-up",
        )
    else:
        yield Finding(OK, f"the shaft moves forward at {at_forward:g} % and in reverse at {at_reverse:g} %")
        if _way(forward) == _way(reverse):
            yield Finding(
                PROBLEM,
                "the shaft turns the same way forward and in reverse",
                "C3 and C4 do not choose the direction: check that both reach the bridge",
            )
            return
    moved = forward or reverse
    assert moved is not None
    wanted = 1.0 if moved is forward else -1.0
    if _way(moved) != wanted:
        yield Finding(
            PROBLEM,
            "forward duty makes the encoder count down: a controller would run away from its reference",
            "swap the two wires of the motor, or channels A and B of the encoder (not both)",
        )
    else:
        yield Finding(OK, "forward duty makes the encoder count up")
    yield from _direction_bit([log for log in (forward, reverse) if log is not None])


def _first_move(bench: Bench, sign: int, most_pct: float) -> tuple[Log | None, float]:
    """The first pulse that moves the shaft, and the largest duty that it reached, or that any did where none moves it.

    A slew limit may hold a pulse below its level.
    """
    counts = 360.0 / bench.counts_per_rev
    most_pct, reached_pct = min(most_pct, bench.profile.limit_duty_pct), 0.0
    for duty in [*(d for d in PULSES_PCT if d < most_pct), most_pct]:
        log = bench.drive(sign * duty, PULSE_S)
        reached_pct = max(reached_pct, float(np.abs(log.duty_pct).max()))
        if abs(log.output[-1] - log.output[0]) >= MOVED_COUNTS * counts:
            return log, reached_pct
    return None, reached_pct


def _way(log: Log) -> float:
    return float(np.sign(log.output[-1] - log.output[0]))


def _direction_bit(logs: Sequence[Log]) -> Iterator[Finding]:
    """Whether the direction bit follows the count."""
    agree = total = 0
    for log in logs:
        change = np.diff(log.output)
        down = log.columns["direction"][1:]
        moving = change != 0.0
        agree += int(np.sum((down[moving] == 1) == (change[moving] < 0.0)))
        total += int(np.sum(moving))
    if total and agree < 0.8 * total:
        yield Finding(
            PROBLEM,
            "the direction bit says the opposite of the count",
            "direction is 0 for counting up in this layout; only the display uses it. Exchange its meaning in the "
            "board's program, or read it with care",
        )
    elif total:
        yield Finding(OK, "the direction bit follows the count")
