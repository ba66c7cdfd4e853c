"""What a model predicts for a record: free runs and one-second windows."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from fiohost.estimation.record import ANGLE, Record, one_by_one
from fiohost.estimation.settings import SETTINGS
from fiohost.estimation.windows import fit_windows, read_output
from fiohost.motor.effect import effect, effects
from fiohost.motor.model import Model, slot
from fiohost.motor.simulate import Excitation, Start, run, seen_angle, start_state
from fiohost.motor.state import (
    BACKLASH,
    FOLLOWING,
    GAIN,
    GAP,
    LOAD_OMEGA,
    LOAD_THETA,
    OMEGA,
    STATE_SIZE,
    STOP,
    STOP_ON,
    THETA,
    WORK_SIZE,
)
from fiohost.noise.runs import shifted

# What keeps more in mind than angle and speed.
REMEMBERING = [i for i, item in enumerate(effects().values()) if item.remembers]

# What warms with time alone, by what a parameter of it says: switch, slot, and the choice.
BY_TIME = [
    (i, slot(f"{item.name}.{q.name}"), float(q.choices.index("time")))
    for i, item in enumerate(effects().values())
    for q in item.parameters
    if item.warms and "time" in q.choices
]


@cache
def phase_slots(name: str) -> tuple[tuple[int, int, int], ...]:
    """Where in the parameter array an effect keeps what moves with the zero of angle, where the order that goes with it
    (-1: nowhere), and how many times it moves then.
    """
    item = effect(name)
    if not item.angle_bound:
        return ()
    order = next((slot(f"{name}.{q.name}") for q in item.parameters if q.whole), -1)
    moving = [q for q in item.parameters if q.order is not None or q.period is not None]
    return tuple(
        (slot(f"{name}.{q.name}"), order if q.order is None else -1, 1 if q.order is None else q.order) for q in moving
    )


class Flat(NamedTuple):
    """A model as the kernel takes it: parameter array, switches, step, and what of it matters for initial states.

    ``phases`` are the slots of phases and orders of what is bound to the angle, and how often they count; ``zero`` is
    where on the bench's turn the angle is zero that they are written for.
    """

    p: np.ndarray
    on: np.ndarray
    substep_s: float
    seen: int
    bends: bool
    gap: bool
    warms: bool
    phases: tuple[tuple[int, int, int], ...] = ()
    zero: float = 0.0

    @classmethod
    def of(cls, model: Model) -> Flat:
        bends = any(effects()[name].angle_bound for name in model.effects)
        on = model.switches()
        warms = any(effects()[name].warms for name in model.effects)
        phases = tuple(where for name in model.effects for where in phase_slots(name))
        p = model.vector()
        return cls(p, on, model.substep_s(), THETA, bends, False, warms, phases).at(p)

    def at(self, p: np.ndarray) -> Flat:
        """The same model with other values in its parameter array, for the bench's zero."""
        gap = bool(self.on[BACKLASH]) and float(p[GAP]) > 0.0
        return self._replace(p=p, seen=seen_angle(p, self.on), gap=gap, zero=0.0)

    @property
    def remembers(self) -> bool:
        """Whether angle and speed are not all of the model's state."""
        return bool(self.on[REMEMBERING].any())

    @property
    def warms_by_time(self) -> bool:
        """Whether how warm it is hangs on time alone: then how warm it was at first cannot be told from what it is."""
        return any(self.on[index] and self.p[at] == choice for index, at, choice in BY_TIME)

    def orders(self) -> list[int]:
        """How often a turn everything repeats that is bound to the angle."""
        return [abs(turns) for turns in self._turns()]

    def _turns(self) -> list[int]:
        """By how many degrees each phase moves with a degree of the zero of angle."""
        return [factor * (round(float(self.p[order])) if order >= 0 else 1) for _, order, factor in self.phases]

    def from_zero(self, zero: float | None) -> Flat:
        """The same model for angles counted from another zero of the bench's turn, in degrees; None: the bench's."""
        turn = (zero or 0.0) - self.zero
        if turn == 0.0 or not self.phases:
            return self
        p = self.p.copy()
        for (phase, _, _), turns in zip(self.phases, self._turns(), strict=True):
            p[phase] += turns * turn
        return self._replace(p=p, zero=zero or 0.0)


def of_run(record: Record, flat: Flat, start: Start) -> Flat:
    """The model for a record's zero, with what is its run's own."""
    flat = flat.from_zero(start.zero)
    own = record.disturbance.own if record.disturbance else None
    if own is None or not own.values.any():
        return flat
    p, on = shifted(flat.p, flat.on, own.values)
    return flat._replace(p=p, on=on)


def read(record: Record, flat: Flat, states: np.ndarray) -> np.ndarray:
    """The record's output (n) from simulated states (n, STATE_SIZE), ``flat`` being for the record's zero."""
    y = np.empty(len(states))
    read_output(record.excitation.times_s, states, record.kind, flat.seen, flat.p, flat.on, y)
    return y


def free_states(
    record: Record, flat: Flat, start: Start, last: int | None = None, excitation: Excitation | None = None
) -> np.ndarray:
    """States (n, STATE_SIZE) of a free run, of all samples or up to ``last``, or of those of an ``excitation``."""
    flat = flat.from_zero(start.zero)
    turned = turned_deg(record, flat)
    begin = start_state(start._replace(angle=start.angle + turned), flat.p, flat.on)
    states = run(excitation or record.excitation, flat.p, flat.on, flat.substep_s, begin, 0, last)
    if turned != 0.0:
        states[:, [THETA, LOAD_THETA]] -= turned
    return states


def window_states(record: Record, flat: Flat, start: Start) -> np.ndarray:
    """States (m, STATE_SIZE) of a free run where the windows that are looked at begin."""
    firsts, ex = record.looked_at[0], record.excitation
    if SETTINGS.sparse * len(firsts) >= len(record.windows):
        return begin_windows(record, free_states(record, flat, start))
    # The first window of a record is always looked at, so this run begins where the whole one does.
    return free_states(record, flat, start, excitation=replace(ex, times_s=ex.times_s[firsts]))


def begin_windows(record: Record, states: np.ndarray) -> np.ndarray:
    """Of states (n, STATE_SIZE) of a free run, those (m, STATE_SIZE) where the windows that are looked at begin."""
    return np.ascontiguousarray(states[record.looked_at[0]])


def turned_deg(record: Record, flat: Flat) -> float:
    """Whole turns between a record's angle and that of an end of travel: a log begins anew within one turn.

    The shaft was never beyond the end, so the turn is the last one on this side of it.
    """
    end = float(flat.p[STOP])
    if not flat.on[STOP_ON] or end == 0.0 or not record.rotary or record.kind != ANGLE:
        return 0.0
    slack = max(SETTINGS.start.end_slack_counts * (record.quantum + record.scatter), SETTINGS.start.end_slack_deg)
    if end > 0.0:
        return 360.0 * float(np.floor((end + slack - record.smooth.max()) / 360.0))
    return 360.0 * float(np.ceil((end - slack - record.smooth.min()) / 360.0))


def free_output(record: Record, flat: Flat, start: Start, last: int | None = None) -> np.ndarray:
    """The output (n) of a free run, of all samples or up to ``last``."""
    flat = flat.from_zero(start.zero)
    return read(record, flat, free_states(record, flat, start, last))


def speed_step(flat: Flat) -> float:
    """A speed difference that is small beside full speed, whatever the unit of the axis."""
    return 1e-4 * 100.0 * abs(float(flat.p[GAIN])) + 1e-12


def fitted_windows(
    record: Record,
    flat: Flat,
    y: np.ndarray,
    windows: tuple[np.ndarray, np.ndarray],
    bases: np.ndarray,
    free_speed: bool,
    columns: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Residuals (k), angle shifts (m) and speeds (m) of windows, by first sample and that after the last (m each),
    fitted from ``bases`` (m, STATE_SIZE), and the outputs' derivatives (2, k) by speed and angle, of which those of a
    fit nearby serve as ``columns``; samples (k) are those of the windows, one after the other.
    """
    ex = record.excitation
    turned = turned_deg(record, flat)
    if turned != 0.0:
        y, bases = y + turned, bases.copy()
        bases[:, [THETA, LOAD_THETA]] += turned
    firsts, lasts = windows
    longest = int(np.max(lasts - firsts))
    edges = one_by_one(firsts, lasts)
    residuals = np.zeros(edges[-1])
    shifts, omegas = np.zeros(len(firsts)), np.zeros(len(firsts))
    known = columns is not None
    own = np.zeros((2, edges[-1])) if columns is None else columns.copy()
    fit_windows(
        ex.times_s, ex.act_times_s, ex.duties_pct, ex.modes, ex.clock_s, y, record.sure, firsts, lasts, edges, bases,
        free_speed, flat.bends, record.kind, flat.seen, flat.substep_s, flat.p, flat.on, speed_step(flat), residuals,
        shifts, omegas, np.zeros(WORK_SIZE), np.empty((longest, STATE_SIZE)), np.empty(longest), np.empty(longest),
        known, own,
    )  # fmt: skip
    return residuals, shifts, omegas, own


def errors(record: Record, flat: Flat, start: Start, windows: bool = False, y: np.ndarray | None = None) -> np.ndarray:
    """Measured, or ``y``, minus simulated as a fit weighs it: of the whole run (n), or of one-second windows (k)."""
    if windows:
        return windowed(record, flat, start, y)[0]
    return np.asarray(record.weights * ((record.y if y is None else y) - free_output(record, flat, start)))


def squared(parts: Iterable[np.ndarray]) -> float:
    """The squared error of residuals (n each), summed up; that of a simulation that ran away is infinite."""
    with np.errstate(over="ignore", invalid="ignore"):
        total = float(sum(float(part @ part) for part in parts))
    return total if np.isfinite(total) else float("inf")


@dataclass(frozen=True)
class Begun:
    """Where a record's windows begin (m, STATE_SIZE) under a model, the outputs (k) there, and their derivatives (2, k)
    by speed and angle there or nearby: with another model nearby the beginnings are found sooner from there.
    """

    states: np.ndarray
    outputs: np.ndarray
    columns: np.ndarray


def windowed(
    record: Record, flat: Flat, start: Start, y: np.ndarray | None = None, near: Begun | None = None
) -> tuple[np.ndarray, Begun]:
    """``window_residuals`` of the free run from a start, whitened where the noise is known, and where windows begin."""
    flat = of_run(record, flat, start)
    if near is None:
        residuals, begun = _from_bases(record, flat, window_states(record, flat, start), y)
        return _as_fitted(record, residuals), begun
    bases = near.states
    if flat.remembers:  # what it keeps in mind beside angle and speed is that of the free run
        states = window_states(record, flat, start)
        bases = moved(states, bases[:, THETA], bases[:, OMEGA])
    residuals, begun = _from_bases(record, flat, bases, y, near.columns)
    return _as_fitted(record, residuals), begun


def some_windows(record: Record, every: int, flat: Flat, start: Start, y: np.ndarray) -> np.ndarray:
    """``windowed`` of output ``y`` (n) in ``every`` so many of a record's windows, as the noise of all weighs them; in
    the others nothing is left.
    """
    flat, part = of_run(record, flat, start), replace(record, every=max(record.every, every))
    left, _ = _from_bases(part, flat, window_states(part, flat, start), y)
    there = np.isin(record.looked_at[0], part.looked_at[0])
    residuals = np.zeros(record.edges[-1])
    residuals[np.repeat(there, np.diff(record.edges))] = left
    return _as_fitted(record, residuals)


def _as_fitted(record: Record, residuals: np.ndarray) -> np.ndarray:
    return record.disturbance.residuals(residuals) if record.disturbance else residuals


def whitened(record: Record, series: np.ndarray) -> np.ndarray:
    """Derivatives (k) over a record's windows as a fit sees them: whitened where the record's noise is known."""
    return record.disturbance.whitened(series) if record.disturbance else series


def window_residuals(
    record: Record, flat: Flat, states: np.ndarray, y: np.ndarray | None = None, near: Begun | None = None
) -> np.ndarray:
    """Measured minus simulated (k) with angle and speed free in each one-second window, other states from
    ``states``, ``flat`` being for the record's zero; found sooner from where windows begin ``near`` by.
    """
    bases = begin_windows(record, states)
    if near is None:
        return _from_bases(record, flat, bases, y)[0]
    return _from_bases(record, flat, moved(bases, near.states[:, THETA], near.states[:, OMEGA]), y, near.columns)[0]


def _from_bases(
    record: Record, flat: Flat, bases: np.ndarray, y: np.ndarray | None, columns: np.ndarray | None = None
) -> tuple[np.ndarray, Begun]:
    data = record.y if y is None else y
    if flat.bends and record.kind != ANGLE:  # where a free run would be by now is no longer where the shaft is
        bases = moved(bases, record.angles(data)[record.looked_at[0]], bases[:, OMEGA])
    fitted = fitted_windows(record, flat, data, record.looked_at, bases, True, columns)
    if columns is None and len(behind := record.behind_gaps):
        _by_seen_speed(record, flat, data, bases, behind, fitted)
    residuals, shifts, omegas, found = fitted
    outputs = data[record.rows] + turned_deg(record, flat) - residuals
    return residuals, Begun(moved(bases, bases[:, THETA] + shifts, omegas), outputs, found)


def _by_seen_speed(
    record: Record,
    flat: Flat,
    y: np.ndarray,
    bases: np.ndarray,
    behind: np.ndarray,
    fitted: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """Put what windows ``behind`` gaps leave where they are fitted from the speed that is seen there in the place of
    what was ``fitted`` from the free run's, where it is less: that knows no command of a gap, and this no reversal.
    """
    (firsts, lasts), edges = record.looked_at, record.edges
    firsts, lasts = firsts[behind], lasts[behind]
    speeds = np.array([record.speed_at(i) for i in firsts.tolist()])
    begun = moved(bases[behind], bases[behind, THETA], speeds)
    others = fitted_windows(record, flat, y, (firsts, lasts), begun, True)
    own = one_by_one(firsts, lasts)
    for i, window in enumerate(behind.tolist()):
        here, there = slice(edges[window], edges[window + 1]), slice(own[i], own[i + 1])
        if squared([others[0][there]]) < squared([fitted[0][here]]):
            fitted[0][here], fitted[3][:, here] = others[0][there], others[3][:, there]
            fitted[1][window], fitted[2][window] = others[1][i], others[2][i]


def moved(states: np.ndarray, thetas: np.ndarray, omegas: np.ndarray) -> np.ndarray:
    """States (m, STATE_SIZE) with other angles and speeds of the motor, its load with it."""
    found = states.copy()
    found[:, LOAD_THETA] += thetas - states[:, THETA]
    for following in (LOAD_OMEGA, *FOLLOWING):
        found[:, following] += omegas - states[:, OMEGA]
    found[:, THETA], found[:, OMEGA] = thetas, omegas
    return found
