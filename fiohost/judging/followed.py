"""What the missing torque follows: the variables that explain it, and whether it is more than random."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from fiohost.estimation.record import ANGLE, Record
from fiohost.judging.levels import levels_of
from fiohost.judging.metrics import Judgement, judge
from fiohost.judging.missing_torque import missing_torque
from fiohost.judging.replica import Replicas, another_day
from fiohost.judging.settings import TORQUE
from fiohost.motor.compiled import compiled
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.estimate import Noise
from fiohost.workers import each


@compiled
def _shifted(torque, edges, bins, counts, shifts, signs, sums, squares):  # type: ignore[no-untyped-def]
    """For each of some shifts (m, records) in time, with ``signs`` (m, records): a torque (n) summed up in the bins
    (n, v) of some variables, and of these sums the squares over the ``counts`` (v, b), added up to ``squares`` (m, v).
    """
    for i in range(shifts.shape[0]):
        sums[:] = 0.0
        for r in range(shifts.shape[1]):
            begin, end = edges[r], edges[r + 1]
            at = end - shifts[i, r]
            for k in range(begin, end):
                at = begin if at == end else at
                value = signs[i, r] * torque[at]
                at += 1
                for v in range(bins.shape[1]):
                    sums[v, bins[k, v]] += value
        for v in range(bins.shape[1]):
            squares[i, v] = 0.0
            for b in range(counts.shape[1]):
                if counts[v, b] > 0.0:
                    squares[i, v] += sums[v, b] ** 2 / counts[v, b]


@dataclass(frozen=True)
class Dependence:
    """How much of the missing torque one variable explains, beside what it would explain by chance."""

    variable: str
    r2: float
    chance_r2: float
    centres: np.ndarray
    means: np.ndarray

    @property
    def significant(self) -> bool:
        return self.r2 > self.chance_r2 and self.r2 > 0.02

    def to_json(self) -> dict[str, float]:
        return {"r2": self.r2, "chance_r2": self.chance_r2}


@dataclass(frozen=True)
class ForceCurve:
    """The missing torque over a variable: ``points`` (m, 3) are its value, the torque in percent of duty that the
    declared model lacks there, and what the final one still lacks; ``follows_pct`` is the share of the declared model's
    missing torque that the curve takes, ``by_chance_pct`` what any would.
    """

    variable: str
    points: np.ndarray
    follows_pct: float
    by_chance_pct: float

    def to_json(self) -> dict[str, object]:
        return {
            "variable": self.variable,
            "kind": "missing_torque",
            "unit": "% of duty",
            "follows_pct": self.follows_pct,
            "by_chance_pct": self.by_chance_pct,
            "points": self.points.tolist(),
        }


def bench_angle(record: Record, judgement: Judgement) -> np.ndarray | None:
    """The simulated angle (n) on the bench's turn, 0 to 360, or what measured speeds add up to; None where the record's
    zero on it is not known.
    """
    if not record.rotary or (record.own_zero and judgement.start.zero is None):
        return None
    return np.asarray(np.mod(_angles(record, judgement) + (judgement.start.zero or 0.0), 360.0))


def _angles(record: Record, judgement: Judgement) -> np.ndarray:
    return judgement.simulated if record.kind == ANGLE else record.angles()


def _variables(record: Record, judgement: Judgement) -> dict[str, np.ndarray]:
    """What the missing torque may follow, each (n); an angle whose zero is unknown is the log's own."""
    simulated = judgement.simulated
    times = record.excitation.times_s
    duty = record.excitation.duties_pct[:-1]
    speed = np.gradient(simulated, times) if record.kind == ANGLE else simulated
    found = {"speed": speed, "speed_sign": np.sign(speed), "duty": duty, "time": times}
    if record.rotary:
        known = bench_angle(record, judgement)
        found["angle"] = np.mod(_angles(record, judgement), 360.0) if known is None else known
    return found


def _bins(values: np.ndarray, name: str) -> np.ndarray:
    if name == "speed_sign":
        return np.asarray(values.astype(int) + 1)
    edges = (
        np.quantile(values, np.linspace(0, 1, TORQUE.bins + 1)[1:-1])
        if name != "angle"
        else np.arange(1, TORQUE.bins) * 360 / TORQUE.bins
    )
    return np.asarray(np.digitize(values, np.unique(edges)))


def _explained(torque: np.ndarray, bins: np.ndarray, weight: float) -> float:
    count = np.bincount(bins, minlength=TORQUE.bins + 1)
    sums = np.bincount(bins, weights=torque, minlength=TORQUE.bins + 1)
    return float(np.sum(sums[count > 0] ** 2 / count[count > 0]) / weight) if weight > 0 else 0.0


@dataclass(frozen=True)
class _Torque:
    """The missing torque (n) of all records, one after the other between ``edges``, and of each variable that it may
    follow the values (n) and the bins (n) that they fall in.
    """

    torque: np.ndarray
    edges: np.ndarray
    values: dict[str, np.ndarray]
    bins: dict[str, np.ndarray]

    @classmethod
    def of(
        cls, records: Sequence[Record], model: Model, judgements: Sequence[Judgement], noise: Noise | None = None
    ) -> _Torque:
        pairs = list(zip(records, judgements, strict=True))
        torques = [missing_torque(r, model, j.free_residual, noise) for r, j in pairs]
        variables = [_variables(r, j) for r, j in pairs]
        edges = np.cumsum([0] + [len(t) for t in torques])
        alone = np.cumsum([r.own_zero and j.start.zero is None for r, j in pairs])
        own_bins = np.repeat(TORQUE.bins * alone * np.diff(alone, prepend=0), np.diff(edges))
        names = [n for n in ("angle", "speed", "speed_sign", "duty", "time") if all(n in v for v in variables)]
        values = {n: np.concatenate([v[n] for v in variables]) for n in names}
        bins = {n: _bins(v, n) + (own_bins if n == "angle" else 0) for n, v in values.items()}
        return cls(np.concatenate(torques), edges, values, bins)

    def share(self, name: str) -> float:
        """The share of the torque's variance about zero that its mean in bins explains."""
        return _explained(self.torque, self.bins[name], float(self.torque @ self.torque))

    @property
    def regressors(self) -> np.ndarray:
        """What an offset load, dry friction and a gain do (n, 3)."""
        return np.column_stack([np.ones(len(self.torque)), self.bins["speed_sign"] - 1.0, self.values["duty"]])

    def beside_own(self) -> _Torque:
        """Without what each record may have of its own: load, friction and gain."""
        left, columns = self.torque.copy(), self.regressors
        for r in map(slice, self.edges[:-1], self.edges[1:]):
            left[r] -= columns[r] @ np.linalg.lstsq(columns[r], left[r], rcond=None)[0]
        return replace(self, torque=left)

    def shares(self) -> dict[str, float]:
        """The shares that follow the angle in either direction, speed and duty, that which swings at one frequency by
        the clock, and those of a friction and a gain that are others in each stretch of a record, beside its mean.
        """
        weight, columns, drifts = float(self.torque @ self.torque), self.regressors[:, 1:], np.zeros(2)
        for begin, end in pairwise(self.edges):
            ran = self.values["time"][begin:end] - self.values["time"][begin]
            parts = np.flatnonzero(np.diff(ran // TORQUE.stretch_s)) + 1
            for part in np.split(np.arange(begin, end), parts):
                by = columns[part] - columns[part].mean(axis=0)
                spans = np.sum(by**2, axis=0)
                drifts += np.divide((by.T @ self.torque[part]) ** 2, spans, out=np.zeros(2), where=spans > 0.0)
        drifts = drifts / weight if weight > 0.0 else drifts
        followed = {n: self.share(n) for n in ("speed", "duty")} | {"time": self.swinging()}
        if "angle" in self.bins:
            each_way = 3 * self.bins["angle"] + self.bins["speed_sign"]
            followed["angle_and_speed_sign"] = _explained(self.torque, each_way, weight)
        return followed | dict(zip(("friction_drift", "gain_drift"), drifts.tolist(), strict=True))

    def swinging(self) -> float:
        """The largest share that swings at one frequency, with a phase of its own in each record (Schuster 1898)."""
        spans = [(self.torque[a:b], self.values["time"][a:b]) for a, b in pairwise(self.edges)]
        longest_s = max(float(times[-1] - times[0]) for _, times in spans)
        taken: np.ndarray | float = 0.0
        for torque, times in spans:
            step_s = float(times[-1] - times[0]) / (len(times) - 1)
            # Of a long record all samples would fill the memory: means of a quarter of the fastest period do.
            block = max(1, int(1.0 / (4.0 * TORQUE.fastest_hz * step_s)))
            means = torque[: len(torque) // block * block].reshape(-1, block).mean(axis=1)
            # On a grid of four points for each frequency that the longest record tells apart.
            grid_hz = np.arange(4.0 * TORQUE.periods, 4.0 * longest_s * TORQUE.fastest_hz) / (4.0 * longest_s)
            size = 1 << int(np.ceil(np.log2(8 * len(means))))
            power = 2.0 * block * np.abs(np.fft.rfft(means, size)) ** 2 / len(means)
            taken = taken + np.interp(grid_hz, np.fft.rfftfreq(size, block * step_s), power, right=0.0)
        weight = float(self.torque @ self.torque)
        return float(np.max(taken, initial=0.0)) / weight if weight > 0.0 else 0.0

    def by_chance(self, rng: np.random.Generator) -> np.ndarray:
        """The shares (shifts, variables) of the torque of each record at another time and with either sign."""
        bins = np.column_stack(list(self.bins.values()))
        most = int(bins.max()) + 1
        counts = np.array([np.bincount(b, minlength=most) for b in bins.T], dtype=float)
        spans = np.diff(self.edges)
        shifts = rng.integers(spans, size=(TORQUE.shifts, len(spans)))
        signs = rng.choice((-1.0, 1.0), size=shifts.shape)
        squares = np.empty((TORQUE.shifts, bins.shape[1]))
        _shifted(self.torque, self.edges, bins, counts, shifts, signs, np.empty_like(counts), squares)
        weight = float(self.torque @ self.torque)
        return squares / weight if weight > 0.0 else np.zeros_like(squares)


def dependences(
    records: Sequence[Record], model: Model, judgements: Sequence[Judgement], rng: np.random.Generator
) -> list[Dependence]:
    """Which variables the missing torque follows over all records, strongest first.

    ``r2`` is the share of the torque's variance about zero explained by its mean in bins of the variable; the chance
    level is the 99 % point of the same share after circular shifts in time, which keep the torque's colour. Every log
    whose zero of the angle is unknown has bins of the angle for itself; the curve is that of the bench's zero.
    """
    found, missing = [], _Torque.of(records, model, judgements)
    for (name, bins), chance in zip(missing.bins.items(), missing.by_chance(rng).T, strict=True):
        inside = [bins == i for i in range(min(bins.max() + 1, TORQUE.bins))]
        centres, means = (
            np.array([x[there].mean() if there.any() else np.nan for there in inside])
            for x in (missing.values[name], missing.torque)
        )
        found.append(Dependence(name, missing.share(name), float(np.quantile(chance, 0.99)), centres, means))
    return sorted(found, key=lambda d: d.r2 - d.chance_r2, reverse=True)


def ruled(
    records: Sequence[Record],
    models: Sequence[Model],
    estimates: Sequence[Sequence[Model]],
    starts: Sequence[Start],
    rng: np.random.Generator,
    noise: Noise,
    least_share: float,
    sigmas: float,
) -> tuple[str, ...]:
    """What the torque that ``models`` (one a record) lack follows beside what is each record's own: angle, speed, duty,
    a friction or a gain that changes in a record; each by more than ``least_share`` of it, and by more than the 99 %
    point that the largest of all of them has in bootstrap samples with the ``noise``, each judged by one of the
    ``estimates`` that samples give (one a record each). A random torque follows nothing but itself, in time. ``sigmas``
    are as ``levels_of`` takes them.
    """

    def lacking(judges: Sequence[Model], data: Sequence[np.ndarray | None]) -> dict[str, float]:
        found = [judge(r, m, y, near=s) for r, m, s, y in zip(records, judges, starts, data, strict=True)]
        if not all(np.isfinite(j.simulated).all() for j in found):
            return {}
        return _Torque.of(records, judges[0], found, noise).beside_own().shares()

    shares = lacking(models, [None] * len(records))
    large = [n for n, share in shares.items() if share > least_share]
    if not large:
        return ()

    def draw(i: int) -> list[float]:
        days = zip(another_day(records, rngs[i]), models, starts, strict=True)
        other = lacking(estimates[i], [Replicas(r, m, s).draw(rngs[i]) for r, m, s in days])
        return [other.get(n, np.nan) for n in shares]

    rngs = rng.spawn(len(estimates))
    drawn = np.array(each(draw, range(len(estimates))))
    drawn = drawn[np.isfinite(drawn).all(axis=1)]  # an estimate that runs away says nothing
    levels = levels_of(drawn, sigmas) if len(drawn) > 1 else np.full(len(shares), np.inf)
    level = dict(zip(shares, levels.tolist(), strict=True))
    return tuple(n for n in large if shares[n] > level[n])


def force_curves(before: Sequence[Dependence], after: Sequence[Dependence]) -> list[ForceCurve]:
    """What declared (``before``) and final model (``after``) lack, over every variable that the first one's follows."""
    left = {d.variable: d for d in after}
    found = []
    for d in before:
        if not d.significant or d.variable not in left or d.variable == "speed_sign":
            continue
        other = left[d.variable]
        there = np.isfinite(d.centres) & np.isfinite(d.means)
        seen = np.isfinite(other.centres) & np.isfinite(other.means)
        rest = (
            np.interp(d.centres[there], other.centres[seen], other.means[seen]) if seen.any() else 0.0 * d.means[there]
        )
        points = np.column_stack((d.centres[there], d.means[there], rest))
        found.append(ForceCurve(d.variable, points, 100.0 * d.r2, 100.0 * d.chance_r2))
    return found
