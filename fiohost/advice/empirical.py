"""What is left when no effect of the library explains it: a curve, and what can be said of its nature.

The residual in one-second windows is regressed on bins of a variable, twice: as a torque, each bin's torque sent
through the linear part of the model, and as an error of measurement, each bin's error taken as it is. What the model's
own parameters could take is taken out of everything first. Both regressions have the same number of unknowns, so that
the one that explains more of the residual's power says which it is. A torque's mark on the position falls with speed
squared, an error of measurement keeps its size in angle: the regression weighs just that.

The curve is a description. It never becomes the name of an effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.advice.windowed import Windowed
from fiohost.estimation.fit import fit
from fiohost.estimation.record import ANGLE, Record
from fiohost.judging.followed import bench_angle
from fiohost.judging.metrics import Judgement, pool
from fiohost.judging.stage import Stage
from fiohost.motor.model import Model

BINS = 16
FLIPS = 200
LEVEL = 0.99
# A shaft slower than this share of its highest speed may stick, where a torque shows nothing.
MOVING = 0.005
# Shares of the curve's power that must be even or odd for it to be called so.
CLEARLY = 0.8
FEWEST = 50
# The curve is the smoothest that keeps this share of what the roughest would explain.
KEPT = 0.98
PENALTIES = np.geomspace(1e6, 1e-6, 40)
NOT_A_STEP = 1e12
TORQUE, MEASUREMENT = "torque", "measurement"
DIRECTED = ("angle", "time")


@dataclass(frozen=True)
class Empirical:
    """A term that would take ``share_of_power`` of the residual in windows, ``by_chance`` what any would.

    ``curve`` (m, 2) is the variable and the missing torque in percent of duty, or the error in the output's unit;
    ``forward`` and ``reverse`` the same by direction of motion where the variable leaves that open. ``chance`` is the
    half width of what a bin reaches by chance, ``over_floor`` the rms that is left over its floor. ``parity``: even is
    the same in both directions, as a load is; odd turns round with them, as friction does.
    """

    variable: str
    parity: str | None
    kind: str
    share_of_power: float
    by_chance: float
    over_floor: float
    unit: str
    curve: np.ndarray
    forward: np.ndarray
    reverse: np.ndarray
    chance: float

    def to_json(self) -> dict[str, object]:
        return {
            "variable": self.variable,
            "parity": self.parity,
            "kind": self.kind,
            "share_of_power": self.share_of_power,
            "by_chance": self.by_chance,
            "residual_over_floor": self.over_floor,
            "unit": self.unit,
            "curve": self.curve.tolist(),
            "forward": self.forward.tolist(),
            "reverse": self.reverse.tolist(),
            "chance": self.chance,
        }


@dataclass(frozen=True)
class _Regression:
    """One variable as one kind: coefficients of the bins (k), with share of power, chance and centres (k, 2)."""

    variable: str
    kind: str
    share: float
    by_chance: float
    coefficients: np.ndarray
    centres: np.ndarray
    chance: float
    parity: str | None

    @property
    def worth(self) -> float:
        return self.share - self.by_chance


class _Evidence:
    """Residuals of all records in windows, and what they may follow."""

    def __init__(self, records: Sequence[Record], model: Model, judgements: Sequence[Judgement]) -> None:
        self.records = records
        self.gain, self.lag_s = model.number("linear.gain_deg_s_per_pct"), model.number("linear.tau_s")
        self.windows = [Windowed(r, self.lag_s) for r in records]
        own = np.vstack(fit(model, records, windows=True, max_iterations=1, tolerance=NOT_A_STEP).jacobians)
        norms = np.linalg.norm(own, axis=0)
        self.own = np.linalg.qr(own[:, norms > 0] / norms[norms > 0])[0]
        self.residual = self.without_own(np.concatenate([j.window_residual for j in judgements]))
        self.power = float(self.residual @ self.residual)
        offsets = np.cumsum([0, *(len(r) for r in records)])
        starts = [o + r.windows[:-1] for o, r in zip(offsets[:-1], records, strict=True)]
        self.edges = np.concatenate(starts)
        self.cuts = offsets
        times = [r.excitation.times_s for r in records]
        self.speed = [
            np.gradient(j.simulated, t) if r.kind == ANGLE else j.simulated
            for r, j, t in zip(records, judgements, times, strict=True)
        ]
        self.values: dict[str, list[np.ndarray]] = {
            "speed": self.speed,
            "speed_sign": [np.sign(v) for v in self.speed],
            "duty": [r.excitation.duties_pct[:-1] for r in records],
            "time": [t + r.excitation.clock_s for t, r in zip(times, records, strict=True)],
        }
        angles = [bench_angle(r, j) for r, j in zip(records, judgements, strict=True)]
        known = [a for a in angles if a is not None]
        if len(known) == len(angles):
            self.values["angle"] = known

    def without_own(self, series: np.ndarray) -> np.ndarray:
        """A series (n, ...) without what the model's own parameters could take."""
        return np.asarray(series - self.own @ (self.own.T @ series))

    def _indicators(self, variable: str) -> tuple[np.ndarray, np.ndarray]:
        """Bins of a variable, by direction where it leaves that open: which (n, k) a sample is in, centres (k, 2)."""
        values, speed = np.concatenate(self.values[variable]), np.concatenate(self.speed)
        if variable == "speed_sign":
            edges = np.zeros(1)
        elif variable == "angle":
            edges = np.arange(1, BINS) * 360.0 / BINS
        else:
            edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, BINS + 1)[1:-1]))
        bins = np.digitize(values, edges)
        moving = np.abs(speed) > MOVING * np.max(np.abs(speed), initial=0.0)
        columns, centres = [], []
        for direction in (1.0, -1.0) if variable in DIRECTED else (0.0,):
            for i in range(len(edges) + 1):
                inside = moving & (bins == i) & ((direction == 0.0) | (np.sign(speed) == direction))
                if inside.sum() >= FEWEST:
                    columns.append(inside)
                    centres.append((float(values[inside].mean()), direction))
        rows = np.array(columns, dtype=np.float64).reshape(len(columns), len(values))
        return rows.T, np.array(centres).reshape(-1, 2)

    def _columns(self, indicators: np.ndarray, kind: str) -> np.ndarray:
        """What each bin does to the output in windows, (n, k)."""
        from scipy.signal import lfilter  # takes a second to load

        parts = []
        for a, b, record, windowed in zip(self.cuts[:-1], self.cuts[1:], self.records, self.windows, strict=True):
            part = indicators[a:b]
            if kind == TORQUE:
                keep = float(np.exp(-record.sample_time_s / self.lag_s))
                part = lfilter([0.0, self.gain * (1.0 - keep)], [1.0, -keep], part, axis=0)
                if record.kind == ANGLE:
                    part = np.cumsum(part, axis=0) * record.sample_time_s
            parts.append(windowed.clean(part))
        return self.without_own(np.vstack(parts))

    def regression(self, variable: str, kind: str, rng: np.random.Generator) -> _Regression | None:
        indicators, centres = self._indicators(variable)
        if len(centres) < 2 or self.power <= 0.0:
            return None
        columns = self._columns(indicators, kind)
        solve = self._smoothest(columns, _roughness(centres, circular=variable == "angle"))
        # Residuals with a random sign for each window: their colour stays, what they follow does not.
        basis = np.linalg.qr(columns)[0]
        signs = rng.choice((-1.0, 1.0), size=(FLIPS, len(self.edges)))
        drawn = signs @ np.add.reduceat(basis * self.residual[:, None], self.edges, axis=0)
        by_chance = float(np.quantile((drawn**2).sum(axis=1), LEVEL)) / self.power
        along = basis.T @ self.residual
        left = self.residual - basis @ along
        noise = signs @ np.add.reduceat(columns * left[:, None], self.edges, axis=0)
        chance = float(np.quantile(np.abs(noise @ solve.T), 0.95))
        share = float(along @ along) / self.power
        found = solve @ (columns.T @ self.residual)
        parity = _parity(centres, found, columns.T @ columns)
        return _Regression(variable, kind, share, by_chance, found, centres, chance, parity)

    def _smoothest(self, columns: np.ndarray, roughness: np.ndarray) -> np.ndarray:
        """What makes a curve (k) of the columns' products with the residual (k): the stiffest that explains enough."""
        normal, along = columns.T @ columns, columns.T @ self.residual
        scale = float(np.trace(normal)) / len(normal)
        floor = 1e-9 * scale * np.eye(len(normal))

        def explained(solve: np.ndarray) -> float:
            c = solve @ along
            return float(2.0 * c @ along - c @ normal @ c)

        solves = [np.linalg.inv(normal + penalty * scale * roughness + floor) for penalty in PENALTIES]
        enough = KEPT * explained(solves[-1])
        return next((s for s in solves if explained(s) >= enough), solves[-1])


def _roughness(centres: np.ndarray, circular: bool) -> np.ndarray:
    """Sum of squared second differences of a curve on bins (k, k), apart for each direction."""
    total = np.zeros((len(centres), len(centres)))
    for direction in np.unique(centres[:, 1]):
        where = np.flatnonzero(centres[:, 1] == direction)
        m = len(where)
        for i in range(m if circular and m > 2 else m - 2):
            row = np.zeros(len(centres))
            for step, weight in enumerate((1.0, -2.0, 1.0)):
                row[where[(i + step) % m]] += weight
            total += np.outer(row, row)
    return total


def _mirrored(centres: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """What a curve (k) is in the opposite direction at each of its bins; None where there is but one direction."""
    x, direction = centres[:, 0], centres[:, 1]
    other = np.empty_like(values)
    if np.all(direction == 0.0):  # a variable that turns round with the direction itself
        order = np.argsort(x)
        if x.min() >= 0.0 or x.max() <= 0.0:
            return None
        return np.asarray(np.interp(-x, x[order], values[order]))
    for d in (1.0, -1.0):
        here, there = direction == d, direction == -d
        if not here.any() or not there.any():
            return None
        order = np.argsort(x[there])
        other[here] = np.interp(x[here], x[there][order], values[there][order])
    return other


def _parity(centres: np.ndarray, values: np.ndarray, normal: np.ndarray) -> str | None:
    """Whether a curve (k) is even or odd in direction, by the power that its two parts explain (k, k)."""
    other = _mirrored(centres, values)
    if other is None:
        return None
    even, odd = (0.5 * (values + sign * other) for sign in (1.0, -1.0))
    powers = float(even @ normal @ even), float(odd @ normal @ odd)
    share = powers[0] / max(sum(powers), 1e-300)
    return "even" if share > CLEARLY else "odd" if share < 1.0 - CLEARLY else "mixed"


def _centred(curve: np.ndarray) -> np.ndarray:
    """A curve (m, 2) about its mean."""
    return curve - [0.0, curve[:, 1].mean()] if len(curve) else curve


def _described(best: _Regression, over_floor: float, unit: str) -> Empirical:
    x, direction, y = best.centres[:, 0], best.centres[:, 1], best.coefficients
    empty = np.empty((0, 2))
    # A level of one direction alone is friction or load, which has a name: only what varies belongs to the variable.
    forward, reverse = (
        _centred(np.column_stack((x, y))[direction == d]) if best.variable in DIRECTED else empty for d in (1.0, -1.0)
    )
    sign = {"even": 1.0, "odd": -1.0}.get(best.parity or "")
    if len(forward) and len(reverse):
        back = np.interp(forward[:, 0], reverse[:, 0], reverse[:, 1])
        curve = forward if sign is None else np.column_stack((forward[:, 0], 0.5 * (forward[:, 1] + sign * back)))
    elif best.variable in DIRECTED:
        curve = forward if len(forward) else reverse
    else:
        other = _mirrored(best.centres, y)
        y = y if sign is None or other is None else 0.5 * (y + sign * other)
        curve = np.column_stack((x, y))[np.argsort(x)]
    return Empirical(
        variable=best.variable,
        parity=best.parity,
        kind=best.kind,
        share_of_power=best.share,
        by_chance=best.by_chance,
        over_floor=over_floor,
        unit="%" if best.kind == TORQUE else unit,
        curve=curve,
        forward=forward,
        reverse=reverse,
        chance=best.chance,
    )


def empirical_term(stage: Stage, records: Sequence[Record], rng: np.random.Generator) -> Empirical | None:
    """The one term that would take most of what a stage leaves, None where nothing takes more than chance would."""
    evidence = _Evidence(records, stage.fit.model, stage.judgements)
    tried = [evidence.regression(v, k, rng) for v in evidence.values for k in (TORQUE, MEASUREMENT)]
    able = [t for t in tried if t is not None and t.worth > 0.0]
    errors, floors = pool([j.errors for j in stage.judgements]), pool([f.errors for f in stage.floors])
    if not able or errors is None or floors is None:
        return None
    over_floor = errors.window_rms / floors.window_rms if floors.window_rms > 0 else np.inf
    return _described(max(able, key=lambda t: t.worth), over_floor, records[0].unit)
