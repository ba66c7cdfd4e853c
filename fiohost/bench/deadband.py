"""The deadband sweep: at which duty the shaft starts from rest, in both directions, over angles and repeats.

By ramps: the duty goes up slowly from rest until the shaft moves. By steps: ``fiohost.bench.starts``. Movement is more
than one count (a shaft at the edge of a count flickers by one) that goes on to CONFIRM_COUNTS; a shaft that creeps a
little and stops again has not started. The start itself is earlier than the first count seen: behind Coulomb friction a
ramp of duty moves the shaft as the square of time, so the square root of the counts is a straight line whose zero is
the start.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.bench.program import Answer
from fiohost.errors import ConfigError, DataError
from fiohost.settings import nearest
from fiohost.wire.messages import Command

CONFIRM_COUNTS = 10
CREEP_S = 2.0  # a movement that takes longer than this to be confirmed is creep, not a start
COARSE_PCT_PER_S = 10.0
FINE_PCT_PER_S = 0.5  # the lag of the shaft reads as a start that is later by this times its time constant
LOADED_PCT = 0.05  # a start below this duty says nothing of friction
UNEVEN_SHARE = 0.3  # of the largest start: beyond it one number for a direction misleads
TURN_DEG = {True: 137.5, False: 60.0}  # between repeats; what remains, 77.5, spreads the starts over the turn
TURN_LIMIT_S = 3.0
PLAY_DEG = 20.0  # a turn shorter than this may not take up the play
PLACE_LIMIT_S = 12.0  # to a place of the turn it may be all the way round
METHODS = ("ramp", "steps")


@dataclass(frozen=True)
class Onset:
    """One start from rest. Series of shape (n,): seconds, percent as acting at that time, degrees from rest.

    ``place_deg`` is the angle that the shaft was to be at, where the sweep has places.
    """

    forward: bool
    duty_pct: float  # signed
    at_angle_deg: float  # of the shaft at rest, 0..360, POS/2
    onset_s: float
    time_s: NDArray[np.float64]
    duty_acting_pct: NDArray[np.float64]
    moved_deg: NDArray[np.float64]
    place_deg: float | None = None


@dataclass(frozen=True)
class Deadband:
    """All starts of a sweep, in the order they were made."""

    onsets: tuple[Onset, ...]
    method: str = METHODS[0]

    def duties(self, forward: bool) -> list[float]:
        return [o.duty_pct for o in self.onsets if o.forward == forward]

    @property
    def u_plus_pct(self) -> float:
        """Mean duty at which the shaft starts forward, > 0."""
        return statistics.fmean(self.duties(True))

    @property
    def u_minus_pct(self) -> float:
        """Mean duty at which the shaft starts in reverse, < 0."""
        return statistics.fmean(self.duties(False))

    def spread_pct(self, forward: bool) -> float:
        """Standard deviation over the repeats; 0 for a single one."""
        found = self.duties(forward)
        return statistics.stdev(found) if len(found) > 1 else 0.0

    def places(self, forward: bool) -> dict[float, list[float]]:
        """Starts by place of the turn, in degrees; empty for a sweep without places."""
        found: dict[float, list[float]] = {}
        for onset in self.onsets:
            if onset.forward == forward and onset.place_deg is not None:
                found.setdefault(onset.place_deg, []).append(onset.duty_pct)
        return dict(sorted(found.items()))

    def spread_over_angle_pct(self, forward: bool) -> float | None:
        """Standard deviation of the means of the places; None for fewer than two."""
        means = [statistics.fmean(duties) for duties in self.places(forward).values()]
        return statistics.stdev(means) if len(means) > 1 else None

    def spread_over_repeats_pct(self, forward: bool) -> float | None:
        """Standard deviation of repeats at one place, pooled over the places; None without repeats."""
        groups = [duties for duties in self.places(forward).values() if len(duties) > 1]
        if not groups:
            return None
        free = sum(len(g) - 1 for g in groups)
        return math.sqrt(sum(statistics.variance(g) * (len(g) - 1) for g in groups) / free)

    def notes(self) -> list[str]:
        """Sentences on what makes a single pair of numbers doubtful."""
        said = []
        for forward, way in ((True, _way(True)), (False, _way(False))):
            found = [abs(duty) for duty in self.duties(forward)]
            if min(found) < LOADED_PCT:
                said.append(f"the shaft starts {way} at almost no duty: nothing holds it there, or a load turns it")
            elif max(found) - min(found) > UNEVEN_SHARE * max(found):
                said.append(
                    f"the start {way} differs between places of the turn ({min(found):.2f} to {max(found):.2f} %): "
                    "a load, cogging or uneven friction; compensate for the smallest"
                )
        return said

    def as_dict(self) -> dict[str, Any]:
        """The result for JSON."""
        sides: dict[str, Any] = {}
        for side, forward in (("u_plus", True), ("u_minus", False)):
            found = self.duties(forward)
            sides |= {
                f"{side}_pct": statistics.fmean(found),
                f"{side}_spread_pct": self.spread_pct(forward),
                f"{side}_range_pct": [min(found), max(found)],
                f"{side}_spread_over_angle_pct": self.spread_over_angle_pct(forward),
                f"{side}_spread_over_repeats_pct": self.spread_over_repeats_pct(forward),
            }
        repeats = [
            {
                "direction": "forward" if o.forward else "reverse",
                "onset_duty_pct": o.duty_pct,
                "at_angle_deg": o.at_angle_deg,
                "onset_s": o.onset_s,
                "place_deg": o.place_deg,
            }
            for o in self.onsets
        ]
        return {
            "schema": "fiohost.deadband/1",
            "method": self.method,
            **sides,
            "repeats": repeats,
            "notes": self.notes(),
        }


def measure_deadband(
    bench: Bench,
    repeats: int = 5,
    max_pct: float = 100.0,
    progress: Callable[[Onset], None] | None = None,
    *,
    method: str = METHODS[0],
    angles: int = 0,
) -> Deadband:
    """Sweep both directions *repeats* times, each time at so many *angles* evenly over the turn, or (0) wherever the
    shaft has been turned on to. Raises DataError where the shaft does not start or turns the wrong way.
    """
    if repeats < 1 or not 1.0 <= max_pct <= 100.0 or not 0 <= angles <= 360:
        raise ConfigError("a deadband sweep needs one repeat or more, a largest duty of 1 to 100 %, 0 to 360 angles")
    if method not in METHODS:
        raise ConfigError(f"unknown method {method!r}; {nearest(method, METHODS)}")

    def start(forward: bool, from_pct: float) -> Onset:
        if method == "steps":
            from fiohost.bench.starts import step_until_it_starts

            return step_until_it_starts(bench, forward, from_pct, max_pct)
        return _ramp(bench, forward, from_pct, FINE_PCT_PER_S, max_pct)

    begin = {forward: _coarse(bench, forward, max_pct) for forward in (True, False)}  # where the slow ramps begin
    places: list[float | None] = [360.0 * i / angles for i in range(angles)] or [None]
    onsets = []
    for place in [place for _ in range(repeats) for place in places]:
        for forward in (True, False):
            _turn_on(bench, forward, begin[forward], max_pct, place)
            onset = start(forward, begin[forward])
            if onset.onset_s < 0.2 and begin[forward] > 0.0:  # it moved at once: here it starts below our beginning
                begin[forward] = 0.0
                onset = start(forward, 0.0)
            begin[forward] = min(0.8 * abs(onset.duty_pct), begin[forward] or math.inf)
            onset = replace(onset, place_deg=place)
            onsets.append(onset)
            if progress is not None:
                progress(onset)
    return Deadband(tuple(onsets), method)


def _coarse(bench: Bench, forward: bool, max_pct: float) -> float:
    """Where a slow ramp may begin: well below the duty at which a fast one starts the shaft."""
    found = abs(_ramp(bench, forward, 0.0, COARSE_PCT_PER_S, max_pct).duty_pct)
    return max(0.0, 0.7 * found - 1.0)


def _turn_on(bench: Bench, forward: bool, begin_pct: float, max_pct: float, place_deg: float | None) -> None:
    """Turn the shaft on in the direction of the sweep: gears against their play, at another angle or a place."""
    duty_pct = min(max_pct, 1.5 * begin_pct + 12.0)
    command = Command.drive(duty_pct if forward else -duty_pct)
    limit_s = TURN_LIMIT_S if place_deg is None else PLACE_LIMIT_S
    bench.play(_TurnBy(command, TURN_DEG[forward], place_deg, round(limit_s / bench.sample_time_s)))


class _TurnBy:
    """One command until the shaft has turned by an angle, or to a place of the turn, or for so many ticks."""

    def __init__(self, command: Command, angle_deg: float, place_deg: float | None, ticks: int) -> None:
        self._command, self._angle_deg, self._place_deg, self._ticks = command, angle_deg, place_deg, ticks
        self._begin_deg: float | None = None

    def step(self, k: int, angle_deg: float) -> Answer | None:
        if self._begin_deg is None:
            self._begin_deg = angle_deg
            if self._place_deg is not None:
                way = self._place_deg - angle_deg
                turn = math.copysign(1.0, self._command.duty_pct) * way % 360.0
                self._angle_deg = turn if turn >= PLAY_DEG else turn + 360.0
        done = abs(angle_deg - self._begin_deg) >= self._angle_deg or k >= self._ticks
        return None if done else (self._command, None)


def _ramp(bench: Bench, forward: bool, begin_pct: float, rate_pct_per_s: float, max_pct: float) -> Onset:
    program = _RampUp(bench, forward, begin_pct, rate_pct_per_s, max_pct)
    log = bench.play(program)
    if program.wrong_way:
        raise turns_the_wrong_way(forward)
    if not program.started:
        raise does_not_start(forward, max_pct)
    return _onset(log, program, forward)


def turns_the_wrong_way(forward: bool) -> DataError:
    return DataError(
        f"the shaft turns against the duty when driven {_way(forward)}: swap the motor's wires or the encoder's "
        "channels, or take the load off that turns it"
    )


def does_not_start(forward: bool, max_pct: float) -> DataError:
    return DataError(
        f"the shaft does not start {_way(forward)} up to {max_pct:g} %: check the supply, the wiring and the pull-ups "
        "of C3 and C4 (without them the motor coasts in every setting)"
    )


def _way(forward: bool) -> str:
    return "forward" if forward else "in reverse"


class _RampUp:
    """Duty from ``begin`` upwards at a constant rate until the shaft has surely started."""

    patience = 10.0  # it stands until then, which is what is measured

    def __init__(self, bench: Bench, forward: bool, begin_pct: float, rate_pct_per_s: float, max_pct: float) -> None:
        self._sign = 1.0 if forward else -1.0
        self._begin = begin_pct
        self._per_tick = rate_pct_per_s * bench.sample_time_s
        self._max = max_pct
        self._counts = bench.counts_per_rev / 360.0
        self._creep_ticks = round(CREEP_S / bench.sample_time_s)
        self._rest_deg: float | None = None
        self._moving_since: int | None = None
        self.rest_tick = 0
        self.started = self.wrong_way = False

    def step(self, k: int, angle_deg: float) -> Answer | None:
        if self._rest_deg is None:
            self._rest_deg = angle_deg
        moved = round(self._sign * (angle_deg - self._rest_deg) * self._counts)
        if moved <= -CONFIRM_COUNTS:
            self.wrong_way = True
            return None
        if moved >= CONFIRM_COUNTS:
            self.started = True
            return None
        if moved <= 1:
            self._moving_since = None
        elif self._moving_since is None:
            self._moving_since = k
        elif k - self._moving_since > self._creep_ticks:
            self._rest_deg, self._moving_since, self.rest_tick = angle_deg, None, k
        duty_pct = self._begin + self._per_tick * k
        if duty_pct > self._max:
            return None
        return Command.drive(self._sign * duty_pct), None


def _onset(log: Log, program: _RampUp, forward: bool) -> Onset:
    time_s = log.time_s
    moved_deg = log.output - log.output[program.rest_tick]
    counts = np.rint((moved_deg if forward else -moved_deg) / log.output_quantum)
    acting = np.interp(time_s - log.command_delay_ticks * log.sample_time_s, time_s, log.duty_pct)
    onset_s = _start_time(time_s[program.rest_tick :], counts[program.rest_tick :])
    first = int(np.argmax(np.abs(acting) > 0.0))  # before it no duty acts at all
    onset_s = max(onset_s, float(time_s[first]))
    return Onset(
        forward=forward,
        duty_pct=float(np.interp(onset_s, time_s, acting)),
        at_angle_deg=float(log.output[program.rest_tick] % 360.0),
        onset_s=onset_s,
        time_s=time_s,
        duty_acting_pct=acting,
        moved_deg=moved_deg,
    )


def _start_time(time_s: NDArray[np.float64], counts: NDArray[np.float64]) -> float:
    """Time at which the shaft started, from the times at which it reached 2, 3, .. counts for good."""
    reached: Sequence[int] = range(2, int(counts[-1]) + 1)
    edges = np.array([time_s[int(np.flatnonzero(counts < n)[-1]) + 1] for n in reached])
    first = float(time_s[int(np.flatnonzero(counts <= 0)[-1])]) if np.any(counts <= 0) else float(time_s[0])
    if edges.size < 4:
        return first
    roots = np.sqrt(np.arange(2, 2 + edges.size) - 0.5)  # the shaft rested somewhere within its count
    slope, at_zero = np.polyfit(edges, roots, 1)
    if not slope > 0.0:
        return first
    return float(np.clip(-at_zero / slope, time_s[0], first))
