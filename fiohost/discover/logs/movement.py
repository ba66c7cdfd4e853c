"""How the shaft of a model moves in one-second windows, as far as noise on it is concerned."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fiohost.discover.settings import SETTINGS
from fiohost.estimation.predict import Flat, speed_step, turned_deg, windowed
from fiohost.estimation.record import ANGLE, Record
from fiohost.motor.electrics import winding_lag
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start, run, speed_kept
from fiohost.motor.state import LOAD_THETA, OMEGA, STANDBY, THETA
from fiohost.noise.covariance import Movement
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


def standing(record: Record, model: Model, start: Start, torque_pct: float) -> np.ndarray:
    """Whether (n) the shaft stands from each sample to the next: where a random torque of ``torque_pct`` rms does not
    turn it.
    """
    push = WHITENING.rest_sigmas * torque_pct
    pushed = [varied(model, np.array([0.0, 0.0, load])) for load in ((-push, push) if push > 0.0 else ())]
    moves = np.zeros(len(record), dtype=bool)
    for one in (model, *pushed):
        speed = simulated_in_windows(record, one, start)[1]
        moves |= np.abs(speed) > WHITENING.stands * float(np.max(np.abs(speed), initial=0.0))
    near = round(WHITENING.kink_s / record.sample_time_s)
    return np.asarray(np.convolve(moves, np.ones(2 * near + 1), mode="same") <= 0.5)


def settling_s(model: Model) -> float:
    """The lag with which a model's speed settles, motor and winding together: by the slower of the roots of
    ``tau T s^2 + tau s + 1`` with the winding's lag T; where both swing, by how fast that dies away.
    """
    tau_s, winding_s = model.number("linear.tau_s"), float(winding_lag(model.vector(), model.switches()))
    return float(max(0.5 * tau_s * (1.0 + np.sqrt(max(1.0 - 4.0 * winding_s / tau_s, 0.0))), 2.0 * winding_s))


def movement(record: Record, model: Model, start: Start) -> Movement:
    """How a model's shaft moves in a record's windows, nowhere at rest: what a small change of its speed becomes from
    each sample to the next says with which lag it settles; where it turns against friction, which share it keeps.
    """
    flat, ex = Flat.of(model).from_zero(start.zero), record.excitation
    tau_s, step = settling_s(model), speed_step(flat)
    shortest, longest = (tau_s * lag for lag in WHITENING.lags)
    lags = np.where(coasting(record), longest, tau_s)
    if not flat.on.any():
        return Movement(lags, np.ones(len(record)))
    record = replace(record, disturbance=None)
    begins = windowed(record, Flat.of(model), start)[1].states.copy()
    begins[:, [THETA, LOAD_THETA]] += turned_deg(record, flat)
    keeps = np.ones(len(record))
    for begin, a, b in zip(begins, *(ends.tolist() for ends in record.looked_at), strict=True):
        states = run(ex, flat.p, flat.on, flat.substep_s, begin, a, b)
        steps, kept = np.diff(ex.times_s[a:b]), speed_kept(ex, flat.p, flat.on, flat.substep_s, states, step, a)
        turns = states[:-1, OMEGA] * states[1:, OMEGA] < 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            own = np.where(kept < 1.0, -steps / np.log(kept), np.inf)
        own = np.where((kept > 0.0) & ~turns, np.clip(own, shortest, longest), lags[a : b - 1])
        lags[a : b - 1] = own
        keeps[a : b - 1] = np.where(turns, np.clip(kept / np.exp(-steps / own), 0.0, 1.0), 1.0)
    return Movement(lags, keeps)


def at_rest(moves: Movement, stands: np.ndarray) -> Movement:
    """The same movement but for where the shaft ``stands`` (n)."""
    return Movement(np.where(stands, 0.0, moves.lag_s), moves.keeps)
