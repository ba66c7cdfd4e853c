"""Derivatives of one-second windows whose angle and speed are free.

Once these are found, a derivative by anything else is that of the output with both held, less what they could take of
it: the Jacobian of variable projection without the projection's own change (Kaufman 1975). That takes one run over the
windows, where fitting all of them anew takes several.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from fiohost.estimation.predict import Begun, Flat, moved, of_run, turned_deg, whitened, window_states
from fiohost.estimation.record import ANGLE, Record
from fiohost.estimation.settings import SETTINGS
from fiohost.estimation.windows import window_outputs
from fiohost.motor.simulate import Start
from fiohost.motor.state import LOAD_THETA, OMEGA, STATE_SIZE, TAU, THETA, WORK_SIZE


class Tangent:
    """A record's windows around where they begin under one model."""

    def __init__(self, record: Record, flat: Flat, start: Start, begun: Begun) -> None:
        self.record = record
        self.flat = of_run(record, flat, start)
        self.begun, self.begins = begun, begun.states
        self.firsts, self.lasts = record.looked_at
        # Of a long record few windows are looked at: everything is of their samples (k), one after the other.
        self.edges, lengths = record.edges, self.lasts - self.firsts
        self.window, self.before = np.repeat(np.arange(len(lengths)), lengths), self.edges[:-1]
        self.rows = record.rows
        self.sure = record.sure[self.rows]

    def by(self, flat: Flat, start: Start, step: float) -> np.ndarray:
        """The derivative (k) by what differs in a model or a start by ``step``; what either remembers beside angle and
        speed is from a free run.
        """
        return np.asarray(self.by_each([(flat, start, step)])[:, 0])

    def by_each(self, changes: Sequence[tuple[Flat, Start, float]]) -> np.ndarray:
        """Derivatives (k, changes) by each of several changes: model, start and step as ``by`` takes them."""
        found = np.empty((len(self.rows), len(changes)))
        for j, (flat, start, step) in enumerate(changes):
            found[:, j] = self.unwhitened(flat, start, step)
        return whitened(self.record, found)

    def unwhitened(self, flat: Flat, start: Start, step: float) -> np.ndarray:
        """The derivative (k) of the windows' samples as they are, one window after the other."""
        flat = of_run(self.record, flat, start)
        begins = self.begins
        if flat.remembers:
            states = window_states(self.record, flat, start)
            begins = moved(states, begins[:, THETA], begins[:, OMEGA])
        outputs, by_angle, by_speed = self._around
        change = (self._outputs(flat, begins) - outputs) / step
        return np.asarray(change - self._along(change, by_angle) - self._along(change, by_speed))

    @cached_property
    def _around(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The windows' outputs (k), and directions (k), square to each other, in which angle and speed move them."""
        outputs, (by_speed, by_angle) = self.begun.outputs, self.begun.columns
        by_angle = self._unit(by_angle, 0.0)
        own, running = (s - self._along(s, by_angle) for s in (by_speed, self._running()))
        return outputs, by_angle, self._unit(own, SETTINGS.stands * self._products(running, running))

    def _running(self) -> np.ndarray:
        """How (k) a speed at its beginning moves a window's output where nothing but the lag slows the shaft."""
        times, tau_s = self.record.excitation.times_s, max(float(self.flat.p[TAU]), 1e-9)
        since = times[self.rows] - times[self.firsts][self.window]
        left = np.exp(-since / tau_s)
        return np.asarray(tau_s * (1.0 - left) if self.record.kind == ANGLE else left)

    def _outputs(self, flat: Flat, begins: np.ndarray) -> np.ndarray:
        """Outputs (k) of windows that begin so."""
        record, ex = self.record, self.record.excitation
        turned = turned_deg(record, self.flat)
        if turned != 0.0:
            begins = begins.copy()
            begins[:, [THETA, LOAD_THETA]] += turned
        outputs = np.zeros(len(self.rows))
        states = np.empty((int(np.max(self.lasts - self.firsts)), STATE_SIZE))
        window_outputs(
            ex.times_s, ex.act_times_s, ex.duties_pct, ex.modes, ex.clock_s, record.y, self.firsts, self.lasts,
            self.edges, begins, record.kind, flat.seen, flat.substep_s, flat.p, flat.on, np.zeros(WORK_SIZE), states,
            outputs,
        )  # fmt: skip
        return outputs

    def _products(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Sums of products (m) over each window's samples, weighed as those are from which its start is found."""
        return np.asarray(np.add.reduceat(self.sure * a * b, self.before))

    def _along(self, series: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """The part (k) of a series along a direction of unit length in each window."""
        return np.asarray(unit * self._products(series, unit)[self.window])

    def _unit(self, series: np.ndarray, least: np.ndarray | float) -> np.ndarray:
        """A series of unit length in each window, zero where its square is no more than ``least``."""
        squares = self._products(series, series)
        there = squares > least
        return np.asarray(series * np.where(there, 1.0 / np.sqrt(np.where(there, squares, 1.0)), 0.0)[self.window])
