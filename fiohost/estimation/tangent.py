"""Derivatives of one-second windows whose angle and speed are free.

Once these are found, a derivative by anything else is that of the output with both held, less what they could take of
it: the Jacobian of variable projection without the projection's own change (Kaufman 1975). That takes one run over the
windows, where fitting all of them anew takes several.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from fiohost.estimation.predict import Flat, free_states, moved, speed_step, turned_deg
from fiohost.estimation.record import Record
from fiohost.estimation.windows import window_change, window_columns
from fiohost.motor.simulate import Start
from fiohost.motor.state import LOAD_THETA, OMEGA, STATE_SIZE, THETA, WORK_SIZE


class Tangent:
    """A record's windows around the states (m, STATE_SIZE) in which they begin under one model."""

    def __init__(self, record: Record, flat: Flat, start: Start, begins: np.ndarray) -> None:
        self.record = record
        self.flat = flat.from_zero(start.zero)
        self.turned = turned_deg(record, self.flat)
        self.begins = begins
        self.firsts, self.lasts = record.looked_at()
        self.longest = int(np.max(self.lasts - self.firsts))

    @cached_property
    def _around(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The windows' outputs (n), and their derivatives (n) by speed and by angle."""
        outputs, by_speed, by_angle = np.zeros((3, len(self.record)))
        ex, flat = self.record.excitation, self.flat
        window_columns(
            ex.times_s, ex.act_times_s, ex.duties_pct, ex.modes, ex.clock_s, self.record.y, self.firsts, self.lasts,
            self._in_its_turn(self.begins), flat.bends, self.record.kind, flat.seen, flat.substep_s, flat.p, flat.on,
            speed_step(flat), outputs, by_speed, by_angle, np.zeros(WORK_SIZE), np.empty((self.longest, STATE_SIZE)),
            np.empty(self.longest),
        )  # fmt: skip
        return outputs, by_speed, by_angle

    def by(self, flat: Flat, start: Start, step: float) -> np.ndarray:
        """The derivative (n) by what differs in a model or a start by ``step``; what either remembers beside angle and
        speed is from a free run.
        """
        flat = flat.from_zero(start.zero)
        begins = self.begins
        if flat.remembers:
            states = free_states(self.record, flat, start)[self.firsts]
            begins = moved(states, begins[:, THETA], begins[:, OMEGA])
        change = np.zeros(len(self.record))
        ex = self.record.excitation
        outputs, by_speed, by_angle = self._around
        window_change(
            ex.times_s, ex.act_times_s, ex.duties_pct, ex.modes, ex.clock_s, self.record.y, self.firsts, self.lasts,
            self._in_its_turn(begins), self.record.kind, flat.seen, flat.substep_s, flat.p, flat.on, outputs,
            by_speed, by_angle, change, np.zeros(WORK_SIZE), np.empty((self.longest, STATE_SIZE)),
            np.empty(self.longest),
        )  # fmt: skip
        return change / step

    def _in_its_turn(self, states: np.ndarray) -> np.ndarray:
        """States in the turn that an end of travel is written for."""
        if self.turned == 0.0:
            return states
        found = states.copy()
        found[:, [THETA, LOAD_THETA]] += self.turned
        return found
