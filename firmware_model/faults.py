"""Faults on request: a line that loses and damages reports, a clock that is not even, a reset, a lost supply.

All random, all repeatable: drawn by the seed of the board. A line keeps its order, as USB and serial ones do: behind a
late report the following ones wait. Of several reports that have come since the last step the board consumes the
newest. The host notices nothing but bytes, or none.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from firmware_model.effect import Parameter
from firmware_model.errors import FirmwareModelError

if TYPE_CHECKING:
    from firmware_model.board import Board


def _ratio(key: str) -> Parameter:
    return Parameter(key, default=0.0, lower=0.0, upper=1.0)


def _moment(key: str) -> Parameter:
    return Parameter(key, default=math.inf, lower=0.0, upper=1e6)


PARAMETERS = (
    Parameter("direction", default=0.0, choices=("both", "to_board", "to_host")),
    _ratio("report_drop_ratio"),
    _ratio("report_double_ratio"),
    _ratio("report_cut_ratio"),
    _ratio("report_corrupt_ratio"),
    _ratio("report_late_ratio"),
    Parameter("report_late_s", default=0.005, lower=0.0, upper=0.5),
    Parameter("tick_jitter_s", default=0.0, lower=0.0, upper=0.05),
    _ratio("tick_late_ratio"),
    Parameter("tick_late_s", default=0.002, lower=0.0, upper=0.5),
    Parameter("clock_ppm", default=0.0, lower=-1e5, upper=1e5),
    _moment("reset_at_s"),
    Parameter("reset_lasts_s", default=0.02, lower=0.0, upper=60.0),
    _moment("supply_lost_at_s"),
    _moment("supply_back_at_s"),
)

SHORTEST_STEP_S = 1e-4  # a late task is followed by the next one at once, but not before it has done its work
BURST_BYTES = 8  # a damaged report has this many random bytes at most, beginning in its first BURST_BYTES


def check(values: Mapping[str, Any], where: str) -> None:
    """Refuse what each key alone cannot show."""
    if values["supply_back_at_s"] <= values["supply_lost_at_s"] and math.isfinite(values["supply_back_at_s"]):
        raise FirmwareModelError(f"{where}: supply_back_at_s must be later than supply_lost_at_s")


class FaultyLine:
    """One direction of a line: reports go in, what arrives within a task step comes out."""

    def __init__(self, faults: Mapping[str, Any], rng: random.Random, step_s: float) -> None:
        self._faults = faults
        self._rng = rng
        self._late_ticks = math.ceil(faults["report_late_s"] / step_s)
        self._tick = 0
        self._waiting: deque[tuple[int, bytes]] = deque()

    def carry(self, report: bytes | None) -> list[bytes]:
        """Let one step pass: *report* is sent in it (None: nothing is), the result arrives in it, oldest first."""
        self._tick += 1
        if report is not None and not self._strikes("report_drop_ratio"):
            if self._strikes("report_cut_ratio"):
                report = report[: self._rng.randrange(max(len(report), 1))]
            if self._strikes("report_corrupt_ratio"):
                report = self._damaged(report)
            due = self._tick + (self._late_ticks if self._strikes("report_late_ratio") else 0)
            if self._waiting:
                due = max(due, self._waiting[-1][0])
            for _ in range(2 if self._strikes("report_double_ratio") else 1):
                self._waiting.append((due, report))
        arrived = []
        while self._waiting and self._waiting[0][0] <= self._tick:
            arrived.append(self._waiting.popleft()[1])
        return arrived

    def _strikes(self, key: str) -> bool:
        ratio: float = self._faults[key]
        return ratio > 0.0 and self._rng.random() < ratio

    def _damaged(self, report: bytes) -> bytes:
        start = self._rng.randrange(BURST_BYTES)
        burst = self._rng.randbytes(self._rng.randint(1, BURST_BYTES))
        return (report[:start] + burst + report[start + len(burst) :])[: len(report)]


class FaultyBoard:
    """A board behind such lines, with such a clock: as the board's own, but any number of reports comes back."""

    def __init__(self, board: Board, faults: Mapping[str, Any], *, seed: int | None = None) -> None:
        self._board = board
        self._faults = faults
        self._clock = random.Random(f"clock {seed}")
        both = faults["direction"] == "both"
        whole = {**faults, **{q.key: 0.0 for q in PARAMETERS if q.key.startswith("report_")}}
        ways = []
        for way in ("to_board", "to_host"):
            hurt = both or faults["direction"] == way
            ways.append(FaultyLine(faults if hurt else whole, random.Random(f"{way} {seed}"), board.step_s))
        self._to_board, self._to_host = ways
        self._ticks = 0
        self._began_s = 0.0
        self._reset_done = False

    def step(self, report: bytes | None) -> list[bytes]:
        """One task step; all reports that reach the host in it, oldest first."""
        faults, board, now_s = self._faults, self._board, self._began_s
        arrived = self._to_board.carry(report)
        board.powered = not faults["supply_lost_at_s"] <= now_s < faults["supply_back_at_s"]
        if now_s >= faults["reset_at_s"] and not self._reset_done:
            board.reset()
            self._reset_done = True
        starting = 0.0 <= now_s - faults["reset_at_s"] < faults["reset_lasts_s"]
        newest = arrived[-1] if arrived and not starting else None
        sent = board.step(newest, span_s=self._span_s())
        return self._to_host.carry(None if starting else sent)

    def _span_s(self) -> float:
        """Time until the next step. Delays are of the single tick; the clock's rate is that of all."""
        faults, rng = self._faults, self._clock
        self._ticks += 1
        due_s = self._ticks * self._board.step_s / (1.0 + 1e-6 * faults["clock_ppm"])
        if faults["tick_jitter_s"] > 0.0:
            due_s += rng.uniform(0.0, faults["tick_jitter_s"])
        if faults["tick_late_ratio"] > 0.0 and rng.random() < faults["tick_late_ratio"]:
            due_s += faults["tick_late_s"]
        began_s, self._began_s = self._began_s, max(due_s, self._began_s + SHORTEST_STEP_S)
        return self._began_s - began_s
