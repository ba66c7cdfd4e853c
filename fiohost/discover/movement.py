"""How the shaft of a model moves in one-second windows, as far as noise on it is concerned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.settings import SETTINGS
from fiohost.discover.workers import each
from fiohost.estimation.predict import Flat, speed_step, turned_deg, windowed
from fiohost.estimation.record import ANGLE, Record
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start, run
from fiohost.motor.state import LOAD_OMEGA, LOAD_THETA, OMEGA, STANDBY, THETA
from fiohost.noise.covariance import COASTS, DRIVEN, REST, Movement, step_of
from fiohost.noise.runs import varied

WHITENING = SETTINGS.whitening


def simulated_in_windows(record: Record, model: Model, start: Start) -> tuple[np.ndarray, np.ndarray]:
    """What windows leave (n), and the speed (n) in them."""
    plain = replace(record, disturbance=None, every=1)
    residual, _ = windowed(plain, Flat.of(model), start)
    speed = record.y - residual
    if record.kind == ANGLE:
        steps = np.diff(speed) / np.diff(record.excitation.times_s)
        within = np.ones(len(steps), dtype=bool)
        within[record.windows[1:-1] - 1] = False  # from one window to the next it jumps
        before = np.maximum.accumulate(np.where(within, np.arange(len(steps)), 0))
        speed = np.append(steps[before], steps[before[-1]])
    return residual, speed


def coasting(record: Record) -> np.ndarray:
    """Whether (n) the bridge is open from each sample to the next."""
    ex = record.excitation
    return np.asarray(ex.modes[np.searchsorted(ex.act_times_s, ex.times_s, side="right")] == STANDBY)


def moving(record: Record, model: Model, start: Start, torque_pct: float) -> np.ndarray:
    """Whether (n) the shaft stands from each sample to the next, is driven or coasts. It stands where a random torque
    of ``torque_pct`` rms does not turn it.
    """
    push = WHITENING.rest_sigmas * torque_pct
    pushed = [varied(model, np.array([0.0, 0.0, load])) for load in ((-push, push) if push > 0.0 else ())]
    moves = np.zeros(len(record), dtype=bool)
    for one in (model, *pushed):
        speed = simulated_in_windows(record, one, start)[1]
        moves |= np.abs(speed) > WHITENING.stands * float(np.max(np.abs(speed), initial=0.0))
    near = round(WHITENING.kink_s / record.sample_time_s)
    moves = np.convolve(moves, np.ones(2 * near + 1), mode="same") > 0.5
    return np.where(moves, np.where(coasting(record), COASTS, DRIVEN), REST)


def turning(record: Record, model: Model, start: Start) -> np.ndarray:
    """Which share (n) of what is off in its speed the shaft keeps from each sample to the next, beside what its lag
    takes: all of it but where it turns.
    """
    flat, ex, keeps = Flat.of(model).from_zero(start.zero), record.excitation, np.ones(len(record))
    if not flat.on.any():
        return keeps  # a linear motor turns as it runs
    record = replace(record, disturbance=None)
    begins = windowed(record, Flat.of(model), start)[1].states.copy()
    begins[:, [THETA, LOAD_THETA]] += turned_deg(record, flat)
    step, tau_s = speed_step(flat), model.number("linear.tau_s")
    for begin, a, b in zip(begins, *(ends.tolist() for ends in record.looked_at()), strict=True):
        states = run(ex, flat.p, flat.on, flat.substep_s, begin, a, b)
        for i in np.flatnonzero(states[:-1, OMEGA] * states[1:, OMEGA] < 0.0).tolist():
            near = states[i].copy()
            near[[OMEGA, LOAD_OMEGA]] += step
            after = run(ex, flat.p, flat.on, flat.substep_s, near, a + i, a + i + 2)[1]
            lag, goes = step_of(ex.times_s[a + i + 1] - ex.times_s[a + i], DRIVEN, tau_s)
            kept = (after[OMEGA] - states[i + 1, OMEGA]) / (step * (1.0 - goes / lag))
            keeps[a + i] = float(np.clip(kept, 0.0, 1.0))
    return keeps


def movement(
    records: Sequence[Record], model: Model, starts: Sequence[Start], how: Sequence[np.ndarray]
) -> tuple[Movement, ...]:
    """How a model's shaft moves in the windows of each record: it stands where ``how`` (n each) says."""
    keeps = each(lambda i: turning(records[i], model, starts[i]), range(len(records)))
    return tuple(Movement(moves, kept) for moves, kept in zip(how, keeps, strict=True))
