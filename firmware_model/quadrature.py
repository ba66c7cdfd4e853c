"""A motor whose encoder's edges are told with their times: what an emulated microcontroller has on its pins.

The disc is looked at often enough that its speed hardly changes from one look to the next, and wherever it may turn
round; the edges in between lie on a straight line. A motor can be taken back to where it was, since an emulator says
only afterwards when its outputs changed.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from firmware_model.encoder import LOOK, levels_of
from firmware_model.errors import FirmwareModelError
from firmware_model.kernel import NO_COMMAND
from firmware_model.layout import INVALID, LEVELS, LOOKS, REALS
from firmware_model.motor import Motor
from firmware_model.plants import Plant

LOOK_S = 2.5e-4  # a motor of 80 ms lag at full duty bends its way by less than 0.001 count meanwhile
MOST_LOOKS = 4096
PIECE_S = 0.25  # run at a time, so that the looks have room


class Edge(NamedTuple):
    """The encoder's levels, A + 2 B, from a time on."""

    time_s: float
    levels: int


class EdgeMotor(Motor):
    """A motor that tells its edges. It moves by :meth:`run_to` only."""

    def __init__(self, plant: Plant, *, within_count: float = 0.5, within_gap: float = 0.5) -> None:
        super().__init__(plant, within_count=within_count, within_gap=within_gap)
        self._r = np.concatenate([self._r, np.zeros(LOOK * MOST_LOOKS)])
        self._state = 0  # of the disc: edges that showed, up and down

    @property
    def levels(self) -> int:
        """A + 2 B now."""
        return int(self._m[LEVELS])

    @property
    def invalid(self) -> int:
        """Changes of both levels at once that the decoder saw."""
        return int(self._m[INVALID])

    def run_to(self, time_s: float, command: tuple[int, float] | None) -> list[Edge]:
        """Run to a time; a *command* (mode, signed duty in percent) acts from now on, None changes nothing."""
        found: list[Edge] = []
        while (span_s := time_s - self.time_s) > PIECE_S:
            found += self._run_piece(time_s - span_s + PIECE_S, command)
            command = None
        if span_s > 0.0 or command is not None:
            found += self._run_piece(time_s, command)
        return found

    def _run_piece(self, time_s: float, command: tuple[int, float] | None) -> list[Edge]:
        span_s = time_s - self.time_s
        mode, duty_pct = self._command = command or self._command
        self._m[LOOKS] = 0
        self._pass(mode if command else NO_COMMAND, duty_pct, span_s, max(1, math.ceil(span_s / LOOK_S)))
        count = int(self._m[LOOKS])
        self._m[LOOKS] = -1
        if count > MOST_LOOKS:
            raise FirmwareModelError("the encoder's edges cannot be told: its shaft turns round too often")
        return self._edges(self._r[REALS : REALS + LOOK * count].reshape(count, LOOK))

    def _edges(self, looks: Any) -> list[Edge]:
        found = []
        for k in np.flatnonzero(looks[:, 2]):
            if k == 0:  # none lies before the first look
                continue
            (t0, a0, _), (t1, a1, shown) = looks[k - 1].tolist(), looks[k].tolist()
            way = 1 if shown > 0.0 else -1
            last = math.floor(a1) + (way < 0)  # the edge passed last: a level changes where a whole number is met
            for back in range(round(abs(shown)) - 1, -1, -1):
                share = (last - way * back - a0) / (a1 - a0)
                self._state += way
                found.append(Edge(t0 + (t1 - t0) * min(max(share, 0.0), 1.0), int(levels_of(self._state))))
        return found

    def save(self) -> tuple[Any, ...]:
        """All that :meth:`restore` needs to come back here."""
        arrays = tuple(array.copy() for array in (self._y, self._r[:REALS], self._m, self._queue))
        return (*arrays, self._command, self._state)

    def restore(self, saved: tuple[Any, ...]) -> None:
        """Be as at :meth:`save`."""
        for array, old in zip((self._y, self._r[:REALS], self._m, self._queue), saved, strict=False):
            array[:] = old
        self._command, self._state = saved[4:]
