"""What a model predicts for a record: free runs, initial states, one-second windows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from math import gcd

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from fiohost.estimation.record import ANGLE, Record
from fiohost.estimation.windows import fit_windows, read_output
from fiohost.motor.effect import effect, effects
from fiohost.motor.model import Model, slot
from fiohost.motor.simulate import Start, run, seen_angle, start_state
from fiohost.motor.state import (
    BACKLASH,
    GAIN,
    GAP,
    HEATING_ON,
    LOAD_THETA,
    SHARE,
    SMALLEST_SHARE,
    STATE_SIZE,
    STOP,
    STOP_ON,
    THETA,
    WARMING_ON,
    WORK_SIZE,
)

# Where a motor may stand in its gap, and how fast a load of its own inertia may drift there, in gaps per second: after
# a sudden stop it goes on from wall to wall.
PLAYS = (0.0, -1.0, 1.0, -0.5, 0.5)
MORE_PLAYS = (-0.75, -0.25, 0.25, 0.75)
DRIFTS = (-3.0, -1.0, -0.3, 0.3, 1.0, 3.0)
LASH_LOOKS = 40
END_SLACK_COUNTS = 3.0
LASH_SIMPLEX = np.array([[0.0, 0.0], [0.15, 0.0], [0.0, 0.3]])
# Up to this span of the residual the midpoint of its bounds says best where within its count a shaft stood.
WITHIN_COUNTS = 1.5
# Warmth is looked for at so many levels from so little, then as close as this share of the distance between two.
WARMTH_LEAST, WARMTH_LOOKS, WARMTH_CLOSE = 1e-3, 10, 1e-2
# A log's own zero: angles looked at for each period, windows looked at, the motion that makes a window worth it.
ZERO_LOOKS, ZERO_WINDOWS, ZERO_MOTION_COUNTS = 6, 20, 4.0
# Around the best of them, in degrees of the phase: how far, from near, how close, and the most looks there.
ZERO_REACH, ZERO_NEAR, ZERO_CLOSE, ZERO_MORE = 45.0, 10.0, 0.2, 16


@cache
def phase_slots(name: str) -> tuple[tuple[int, int], ...]:
    """Where in the parameter array an effect keeps its phase and the order that goes with it (-1: once a turn)."""
    parameters = effect(name).parameters
    order = next((slot(f"{name}.{q.name}") for q in parameters if q.whole), -1)
    return tuple((slot(f"{name}.{q.name}"), order) for q in parameters if q.period is not None)


@dataclass(frozen=True)
class Flat:
    """A model as the kernel takes it: parameter array, switches, step, and what of it matters for initial states.

    ``phases`` are the slots of phases and orders of what is bound to the angle; ``zero`` is where on the bench's turn
    the angle is zero that they are written for.
    """

    p: np.ndarray
    on: np.ndarray
    substep_s: float
    seen: int
    bends: bool
    gap: bool
    warms: bool
    phases: tuple[tuple[int, int], ...] = ()
    zero: float = 0.0

    @classmethod
    def of(cls, model: Model) -> Flat:
        bends = any(effects()[name].angle_bound for name in model.effects)
        on = model.switches()
        warms = bool(on[HEATING_ON] or on[WARMING_ON])
        phases = tuple(where for name in model.effects for where in phase_slots(name))
        return cls(model.vector(), on, model.substep_s(), THETA, bends, False, warms, phases).at(model.vector())

    def at(self, p: np.ndarray) -> Flat:
        """The same model with other values in its parameter array, for the bench's zero."""
        gap = bool(self.on[BACKLASH]) and float(p[GAP]) > 0.0
        return replace(self, p=p, seen=seen_angle(p, self.on), gap=gap, zero=0.0)

    def orders(self) -> list[int]:
        """How often a turn everything repeats that is bound to the angle."""
        return [round(float(self.p[order])) if order >= 0 else 1 for _, order in self.phases]

    def from_zero(self, zero: float | None) -> Flat:
        """The same model for angles counted from another zero of the bench's turn, in degrees; None: the bench's."""
        turn = (zero or 0.0) - self.zero
        if turn == 0.0 or not self.phases:
            return self
        p = self.p.copy()
        for (phase, _), order in zip(self.phases, self.orders(), strict=True):
            p[phase] += order * turn
        return replace(self, p=p, zero=zero or 0.0)


def read(record: Record, flat: Flat, states: np.ndarray) -> np.ndarray:
    """The record's output (n) from simulated states (n, STATE_SIZE), ``flat`` being for the record's zero."""
    y = np.empty(len(states))
    read_output(record.excitation.times_s, states, record.kind, flat.seen, flat.p, flat.on, y)
    return y


def free_states(record: Record, flat: Flat, start: Start, last: int | None = None) -> np.ndarray:
    """States (n, STATE_SIZE) of a free run, of all samples or up to ``last``."""
    flat = flat.from_zero(start.zero)
    turned = turned_deg(record, flat)
    begin = start_state(start._replace(angle=start.angle + turned), flat.p, flat.on)
    states = run(record.excitation, flat.p, flat.on, flat.substep_s, begin, 0, last)
    if turned != 0.0:
        states[:, [THETA, LOAD_THETA]] -= turned
    return states


def turned_deg(record: Record, flat: Flat) -> float:
    """Whole turns between a record's angle and that of an end of travel: a log begins anew within one turn.

    The shaft was never beyond the end, so the turn is the last one on this side of it.
    """
    end = float(flat.p[STOP])
    if not flat.on[STOP_ON] or end == 0.0 or not record.rotary or record.kind != ANGLE:
        return 0.0
    slack = END_SLACK_COUNTS * record.quantum
    if end > 0.0:
        return 360.0 * float(np.floor((end + slack - record.y.max()) / 360.0))
    return 360.0 * float(np.ceil((end - slack - record.y.min()) / 360.0))


def free_output(record: Record, flat: Flat, start: Start, last: int | None = None) -> np.ndarray:
    """The output (n) of a free run, of all samples or up to ``last``."""
    flat = flat.from_zero(start.zero)
    return read(record, flat, free_states(record, flat, start, last))


def _speed_step(flat: Flat) -> float:
    """A speed difference that is small beside full speed, whatever the unit of the axis."""
    return 1e-4 * 100.0 * abs(float(flat.p[GAIN])) + 1e-12


def _fit(
    record: Record, flat: Flat, y: np.ndarray, edges: np.ndarray, bases: np.ndarray, free_speed: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residuals (n), angle shifts (m) and speeds (m) of windows fitted from ``bases`` (m, STATE_SIZE)."""
    ex = record.excitation
    turned = turned_deg(record, flat)
    if turned != 0.0:
        y, bases = y + turned, bases.copy()
        bases[:, [THETA, LOAD_THETA]] += turned
    longest = int(np.max(np.diff(edges)))
    residuals = np.zeros(int(edges[-1]))
    shifts, omegas = np.zeros(len(edges) - 1), np.zeros(len(edges) - 1)
    work = np.empty((4, longest))
    fit_windows(
        ex.times_s, ex.act_times_s, ex.duties_pct, ex.modes, ex.clock_s, y, edges, bases, free_speed, flat.bends,
        record.kind, flat.seen, flat.substep_s, flat.p, flat.on, _speed_step(flat), residuals, shifts, omegas,
        np.zeros(WORK_SIZE), np.empty((longest, STATE_SIZE)), work[0], work[1], work[2], work[3],
    )  # fmt: skip
    return residuals, shifts, omegas


def initial_guess(record: Record, y: np.ndarray) -> tuple[float, float]:
    """Angle and speed of the first samples, straight from the data."""
    if record.at_rest:
        return (float(y[0]) if record.kind == ANGLE else 0.0), 0.0
    if record.kind != ANGLE:
        return 0.0, float(np.median(y[:3]))
    times = record.excitation.times_s[:6]
    slope = float(np.polyfit(times, y[: len(times)], 1)[0])
    return float(y[0]), slope


def best_lash(flat: Flat, cost: Callable[[float, float], float]) -> tuple[float, float]:
    """Where in a gap the motor stands at a start, -1 to 1, and the drift of a load that has an inertia of its own.

    Sides, points between, and a finer search around the best; zeros without a gap.
    """
    if not flat.gap:
        return 0.0, 0.0
    gap = float(flat.p[GAP])
    tried = {(play, 0.0): cost(play, 0.0) for play in PLAYS}
    drifts = flat.p[SHARE] >= SMALLEST_SHARE
    if drifts:
        tried |= {(play, d * gap): cost(play, d * gap) for play in (*PLAYS, *MORE_PLAYS) for d in DRIFTS}
    best = min(tried, key=lambda at: tried[at])

    if not drifts:
        low, high = max(best[0] - 0.5, -1.0), min(best[0] + 0.5, 1.0)
        line = minimize_scalar(
            lambda play: cost(play, 0.0), bounds=(low, high), method="bounded", options={"xatol": 0.01, "maxiter": 12}
        )
        return (float(line.x), 0.0) if line.fun < tried[best] * 0.999 else best
    begin = np.array([best[0], best[1] / gap])
    plane = minimize(  # type: ignore[call-overload]
        lambda x: cost(float(np.clip(x[0], -1.0, 1.0)), float(x[1]) * gap),
        begin,
        method="Nelder-Mead",
        options={"initial_simplex": begin + LASH_SIMPLEX, "maxfev": LASH_LOOKS},
    )
    if plane.fun >= tried[best] * 0.999:
        return best
    return float(np.clip(plane.x[0], -1.0, 1.0)), float(plane.x[1]) * gap


def has_own_zero(record: Record, flat: Flat) -> bool:
    """Whether where a record's zero is on the bench's turn is unknown and matters."""
    return record.own_zero and bool(flat.phases)


def _look_windows(record: Record, y: np.ndarray) -> list[tuple[int, int, float]]:
    """Windows (first, end, speed at first) spread over a record in which the shaft moves."""
    times, edges = record.excitation.times_s, record.windows
    moving = [
        (int(a), int(b))
        for a, b in zip(edges[:-1], edges[1:], strict=True)
        if float(np.ptp(y[a:b])) > ZERO_MOTION_COUNTS * record.quantum
    ]
    chosen = np.unique(np.linspace(0, len(moving) - 1, min(len(moving), ZERO_WINDOWS)).round().astype(int))
    found = []
    for a, b in (moving[i] for i in chosen):
        early = slice(a, min(a + max(5, (b - a) // 20), b))
        found.append((a, b, float(np.polyfit(times[early] - times[a], y[early], 1)[0])))
    return found


def find_zero(record: Record, flat: Flat, y: np.ndarray | None = None, near: float | None = None) -> float:
    """Where on the bench's turn a record's zero is, in degrees, from windows whose angle and speed are free.

    Looked for all around what repeats with the turn; with ``near`` only there, and where other orders than one of the
    model's would leave that one as it is. Then along the line: where the shaft sticks, slopes say little.
    """
    data = record.y if y is None else y
    windows = _look_windows(record, data)
    if not windows:
        return near or 0.0
    orders = flat.orders()
    once, fastest = gcd(*orders), max(orders)

    def cost(zero: float) -> float:
        seen = flat.from_zero(zero)
        total = 0.0
        for a, b, speed in windows:
            base = start_state(Start(float(data[a]), speed), seen.p, seen.on)[None, :]
            residuals, _, _ = _fit(record, seen, data, np.array([a, b], dtype=np.int64), base, True)
            total += float(residuals @ residuals)
        return total

    if near is None:
        looks = ZERO_LOOKS * (fastest // once)
        zeros = [360.0 / once * i / looks for i in range(looks)]
    else:
        zeros = [near, *sorted({near + 360.0 * k / n for n in set(orders) if n > once for k in range(1, n // once)})]
    best = min(zeros, key=cost) if len(zeros) > 1 else zeros[0]
    reach = (ZERO_REACH if near is None else ZERO_NEAR) / fastest
    found = minimize_scalar(
        cost,
        bounds=(best - reach, best + reach),
        method="bounded",
        options={"xatol": ZERO_CLOSE / fastest, "maxiter": ZERO_MORE},
    )
    zero = float(found.x) if found.fun < cost(best) else best
    return (zero + 180.0) % 360.0 - 180.0


def initial_state(record: Record, flat: Flat, y: np.ndarray | None = None, *, near: Start | None = None) -> Start:
    """How a record begins, from its first second: least squares for angle and speed, the best side of any gap.

    The speed is zero where the shaft begins at rest. A count bounds the angle on both sides, so where the model stays
    about within one count of the data the midpoint of the bounds is sharper than the mean (set-membership estimate):
    of a shaft that soon rests, the mean would be that one angle's place within its count. What the first second cannot
    show, the warmth and where a log's own zero is, is from the whole record; ``near`` is how
    the same shaft began, as far as it is known.
    """
    data = record.y if y is None else y
    zero = find_zero(record, flat, data, near.zero if near else None) if has_own_zero(record, flat) else None
    flat = flat.from_zero(zero)
    angle, speed = initial_guess(record, data)
    edges = np.array([0, record.first_second()], dtype=np.int64)

    def attempt(play: float, drift: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        base = start_state(Start(angle, speed, play, drift), flat.p, flat.on)[None, :]
        return _fit(record, flat, data, edges, base, not record.at_rest)

    def cost(play: float, drift: float) -> float:
        residuals, _, _ = attempt(play, drift)
        return float(residuals @ residuals)

    play, drift = best_lash(flat, cost)
    residuals, shifts, speeds = attempt(play, drift)
    found = angle + float(shifts[0])
    if record.kind == ANGLE and 0.0 < float(np.ptp(residuals)) <= WITHIN_COUNTS * record.quantum:
        found += 0.5 * float(residuals.max() + residuals.min())
    start = Start(found, float(speeds[0]), play, drift, zero=zero)
    return start._replace(warmth=initial_warmth(record, flat, start, data)) if flat.warms else start


def initial_warmth(record: Record, flat: Flat, start: Start, y: np.ndarray) -> float:
    """How warm winding or bearings were at the start, 0 to 1, from the whole run: the first second cannot show it."""
    weights = record.weights**2

    def cost(warmth: float) -> float:
        residual = y - free_output(record, flat, start._replace(warmth=warmth))
        offset = float(np.average(residual, weights=weights)) if record.kind == ANGLE else 0.0
        return float(np.sum(weights * (residual - offset) ** 2))

    looks = np.concatenate(([0.0], np.geomspace(WARMTH_LEAST, 1.0, WARMTH_LOOKS)))
    costs = [cost(float(w)) for w in looks]
    best = int(np.argmin(costs))
    low, high = looks[max(best - 1, 0)], looks[min(best + 1, len(looks) - 1)]
    xatol = WARMTH_CLOSE * float(high - low)
    found = minimize_scalar(
        cost, bounds=(float(low), float(high)), method="bounded", options={"xatol": xatol, "maxiter": 20}
    )
    return float(found.x) if found.fun < costs[best] else float(looks[best])


def window_residuals(record: Record, flat: Flat, states: np.ndarray, y: np.ndarray | None = None) -> np.ndarray:
    """Measured minus simulated (n) with angle and speed free in each one-second window, other states from
    ``states``, ``flat`` being for the record's zero.
    """
    data = record.y if y is None else y
    bases = np.ascontiguousarray(states[record.windows[:-1]])
    residuals, _, _ = _fit(record, flat, data, record.windows, bases, True)
    return np.asarray(residuals)
