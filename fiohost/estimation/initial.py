"""How a record begins: angle and speed from its first second, the place in a gap, warmth and the turn's own zero."""

from __future__ import annotations

from collections.abc import Callable
from math import gcd

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from fiohost.estimation.predict import Flat, errors, fitted_windows, some_windows, squared
from fiohost.estimation.record import ANGLE, Record, one_by_one
from fiohost.estimation.settings import SETTINGS
from fiohost.motor.simulate import Start, start_state
from fiohost.motor.state import GAP, SHARE, SMALLEST_SHARE

BEGINNING = SETTINGS.start


def initial_guess(record: Record, y: np.ndarray) -> tuple[float, float]:
    """Angle and speed of the first samples, straight from the data."""
    if record.at_rest:
        return (float(y[0]) if record.kind == ANGLE else record.begun_deg), 0.0
    if record.kind != ANGLE:
        return record.begun_deg, float(np.median(y[:3]))
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
    tried = {(play, 0.0): cost(play, 0.0) for play in BEGINNING.plays}
    drifts = flat.p[SHARE] >= SMALLEST_SHARE
    if drifts:
        tried |= {
            (play, d * gap): cost(play, d * gap)
            for play in (*BEGINNING.plays, *BEGINNING.more_plays)
            for d in BEGINNING.drifts
        }
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
        options={
            "initial_simplex": begin + np.vstack((np.zeros(2), np.diag(BEGINNING.lash_steps))),
            "maxfev": BEGINNING.lash_looks,
        },
    )
    if plane.fun >= tried[best] * 0.999:
        return best
    return float(np.clip(plane.x[0], -1.0, 1.0)), float(plane.x[1]) * gap


def has_own_zero(record: Record, flat: Flat) -> bool:
    """Whether where a record's zero is on the bench's turn is unknown and matters."""
    return record.own_zero and bool(flat.phases)


def has_own_warmth(record: Record, flat: Flat) -> bool:
    """Whether how warm a record began is unknown and matters: where the bench's time begins it is cold by definition,
    as only differences are seen of what warms by time.
    """
    return flat.warms and not (record.begins and flat.warms_by_time)


def _look_windows(record: Record, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Windows spread over a record in which the shaft moves by its ``angles`` (n): where each begins and ends, and its
    speed there (k).
    """
    times, edges = record.excitation.times_s, record.windows
    count = record.quantum * (1.0 if record.kind == ANGLE else record.sample_time_s)
    moving = [
        (int(a), int(b))
        for a, b in zip(edges[:-1], edges[1:], strict=True)
        if float(np.ptp(angles[a:b])) > BEGINNING.zero_motion_counts * count
    ]
    chosen = np.unique(np.linspace(0, len(moving) - 1, min(len(moving), BEGINNING.zero_windows)).round().astype(int))
    speeds = []
    for a, b in (moving[i] for i in chosen):
        early = slice(a, min(a + max(5, (b - a) // 20), b))
        speeds.append(float(np.polyfit(times[early] - times[a], angles[early], 1)[0]))
    firsts, ends = np.array([moving[i] for i in chosen], dtype=np.int64).reshape(-1, 2).T
    return firsts, ends, np.array(speeds)


def find_zero(
    record: Record, flat: Flat, y: np.ndarray | None = None, near: float | None = None, closely: bool = True
) -> float:
    """Where on the bench's turn a record's zero is, in degrees, from windows whose angle and speed are free.

    Looked for all around what repeats with the turn; with ``near`` only there, and where other orders than one of the
    model's would leave that one as it is. Then ``closely`` along the line: where the shaft sticks, slopes say little.
    Each window is taken to err by a size of its own: one in which a weight is not lifted that was may be whole turns
    off, and says little of where the zero is.
    """
    data = record.y if y is None else y
    angles = record.angles(data)
    firsts, ends, speeds = _look_windows(record, angles)
    if not len(firsts):
        return near or 0.0
    own, lengths = one_by_one(firsts, ends), (ends - firsts).astype(float)
    least = max(record.quantum**2 / 12.0, 1e-12 * float(np.var(data)), 1e-300)
    orders = flat.orders()
    once, fastest = gcd(*orders), max(orders)

    def cost(zero: float) -> float:
        seen = flat.from_zero(zero)
        begins = [Start(float(angles[a]), speed) for a, speed in zip(firsts, speeds, strict=True)]
        bases = np.array([start_state(begin, seen.p, seen.on) for begin in begins])
        residuals, _, _, _ = fitted_windows(record, seen, data, (firsts, ends), bases, True)
        squares = np.add.reduceat(residuals**2, own[:-1])
        return float(lengths @ np.log(squares / lengths + least))

    if near is None:
        looks = BEGINNING.zero_looks * (fastest // once)
        zeros = [360.0 / once * i / looks for i in range(looks)]
    else:
        zeros = [near, *sorted({near + 360.0 * k / n for n in set(orders) if n > once for k in range(1, n // once)})]
    best = min(zeros, key=cost) if len(zeros) > 1 else zeros[0]
    if not closely:
        return best
    reach = (BEGINNING.zero_reach_deg if near is None else BEGINNING.zero_near_deg) / fastest
    found = minimize_scalar(
        cost,
        bounds=(best - reach, best + reach),
        method="bounded",
        options={"xatol": BEGINNING.zero_close_deg / fastest, "maxiter": BEGINNING.zero_more},
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
    start = _first_second(record, flat, data, 0.0)._replace(zero=zero)
    if not has_own_warmth(record, flat):
        return start
    warmth = initial_warmth(record, flat, start, data, near.warmth if near else None)
    return _first_second(record, flat, data, warmth)._replace(zero=zero)


def _first_second(record: Record, flat: Flat, y: np.ndarray, warmth: float) -> Start:
    """How a record of output ``y`` (n) begins that is so warm, ``flat`` being for the record's zero."""
    angle, speed = initial_guess(record, y)
    first = (np.array([0], dtype=np.int64), np.array([record.first_second()], dtype=np.int64))

    def attempt(play: float, drift: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        base = start_state(Start(angle, speed, play, drift, warmth), flat.p, flat.on)[None, :]
        residuals, shifts, speeds, _ = fitted_windows(record, flat, y, first, base, not record.at_rest)
        return residuals[: record.first_second()], shifts, speeds

    def cost(play: float, drift: float) -> float:
        residuals, _, _ = attempt(play, drift)
        return float(residuals @ residuals)

    play, drift = best_lash(flat, cost)
    residuals, shifts, speeds = attempt(play, drift)
    found = angle + float(shifts[0])
    if record.kind == ANGLE and 0.0 < float(np.ptp(residuals)) <= BEGINNING.within_counts * record.quantum:
        found += 0.5 * float(residuals.max() + residuals.min())
    return Start(found, float(speeds[0]), play, drift, warmth)


def initial_warmth(record: Record, flat: Flat, start: Start, y: np.ndarray, near: float | None = None) -> float:
    """How warm winding or bearings were at the start, 0 to 1, from the whole run: the first second cannot show it.

    Windows come ``near`` where nothing else does, the whole run where a few of its windows show little; then the whole
    run, which is sharper and, where the shaft sticks, rugged. What a whole run leaves behind a gap in its commands, or
    under a random torque, says nothing of warmth: there all windows do.
    """

    def in_whole(warmth: float) -> float:
        error, weights = errors(record, flat, start._replace(warmth=warmth), False, y), record.weights
        if record.kind == ANGLE:
            error = error - weights * float(error @ weights) / float(weights @ weights)
        return squared([error])

    windows_alone = record.broken or record.disturbance is not None
    sharp = _in_windows(record, flat, start, y, 1) if windows_alone else in_whole
    if near is not None:
        return _around(sharp, near)
    looks = np.linspace(0.0, 1.0, BEGINNING.warmth_looks)
    by_windows = _least(_in_windows(record, flat, start, y), 0.0, 1.0, BEGINNING.warmth_near)
    if windows_alone:
        return _around(sharp, by_windows)
    near = min((by_windows, *looks.tolist()), key=in_whole)
    reach = BEGINNING.warmth_near if near == by_windows else float(looks[1])
    return _least(in_whole, max(near - reach, 0.0), min(near + reach, 1.0), BEGINNING.warmth_close)


def guessed_warmth(record: Record, flat: Flat, start: Start, y: np.ndarray) -> float:
    """About how warm it was at the start, for a fit that goes on from there: the least of the parabola through the
    errors of cold, half warm and warm.
    """
    return _parabola(_in_windows(record, flat, start, y), 0.0, 1.0)[0]


def _parabola(cost: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Where the parabola through a cost at two ends and their middle is least between them, and the least cost seen."""
    at = (low, 0.5 * (low + high), high)
    first, half, last = costs = [cost(w) for w in at]
    bend = first - 2.0 * half + last
    if not bend > 0.0:
        return at[int(np.argmin(costs))], min(costs)
    return min(max(at[1] + 0.25 * (high - low) * (first - last) / bend, low), high), min(costs)


def _around(cost: Callable[[float], float], near: float) -> float:
    """Where a cost by warmth is least around a level; ever further from it while it is least at an end."""
    reach = BEGINNING.warmth_near
    while True:
        low, high = max(near - reach, 0.0), min(near + reach, 1.0)
        found = _bottom(cost, low, high)
        if low < found < high or found in (0.0, 1.0):
            return found
        reach *= BEGINNING.warmth_further


def _bottom(cost: Callable[[float], float], low: float, high: float) -> float:
    """Where a cost that is smooth between two near ends is least; by looks along the line where it is not."""
    found, seen = _parabola(cost, low, high)
    return found if cost(found) <= seen else _least(cost, low, high, BEGINNING.warmth_close)


def _in_windows(
    record: Record, flat: Flat, start: Start, y: np.ndarray, every: int = BEGINNING.warmth_every
) -> Callable[[float], float]:
    """Squared error of one-second windows of output ``y`` (n), ``every`` so many of them, by warmth."""
    every = min(every, len(record.windows) - 1)

    def cost(warmth: float) -> float:
        return squared([some_windows(record, every, flat, start._replace(warmth=warmth), y)])

    return cost


def _least(cost: Callable[[float], float], low: float, high: float, xatol: float) -> float:
    """Where a cost is least between two ends: the best of some looks, then along the line around it."""
    looks = np.linspace(low, high, BEGINNING.warmth_looks)
    costs = [cost(float(w)) for w in looks]
    best = int(np.argmin(costs))
    bounds = (float(looks[max(best - 1, 0)]), float(looks[min(best + 1, len(looks) - 1)]))
    found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": xatol, "maxiter": 20})
    return float(found.x) if found.fun < costs[best] else float(looks[best])
