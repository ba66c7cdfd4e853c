"""Derivatives of one-second windows whose angle and speed are free.

Once these are found, a derivative by anything else is that of the output with both held, less what they could take of
it: the Jacobian of variable projection without the projection's own change (Kaufman 1975). That takes one run over the
windows, where fitting all of them anew takes several.
"""

from __future__ import annotations

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
        flat = flat.from_zero(start.zero)
        self.turned = turned_deg(record, flat)
        self.begins = begins
        self.firsts, self.lasts = record.looked_at()
        self.longest = int(np.max(self.lasts - self.firsts))
        self.outputs, self.by_speed, self.by_angle = np.zeros((3, len(record)))
        ex = record.excitation
        window_columns(
            ex.times_s, ex.act_times_s, ex.duties_pct, ex.modes, ex.clock_s, record.y, self.firsts, self.lasts,
            self._in_its_turn(begins), flat.bends, record.kind, flat.seen, flat.substep_s, flat.p, flat.on,
            speed_step(flat), self.outputs, self.by_speed, self.by_angle, np.zeros(WORK_SIZE),
            np.empty((self.longest, STATE_SIZE)), np.empty(self.longest),
        )  # fmt: skip

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
        window_change(
            ex.times_s, ex.act_times_s, ex.duties_pct, ex.modes, ex.clock_s, self.record.y, self.firsts, self.lasts,
            self._in_its_turn(begins), self.record.kind, flat.seen, flat.substep_s, flat.p, flat.on, self.outputs,
            self.by_speed, self.by_angle, change, np.zeros(WORK_SIZE), np.empty((self.longest, STATE_SIZE)),
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
