"""How small an effect would still have been seen in these data: detection limits where nothing is missing.

An effect is put into the final model at a size, the model's own parameters take what they can of it, and the rest is
added to the residual that is there. The limit is the size at which a figure of a log passes the bound that the verdict
holds it against: from there on the data would not have been called complete.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from fiohost.advice.limit import Limit
from fiohost.advice.windowed import Windowed
from fiohost.discover.screen import Trial, candidates, span_of
from fiohost.discover.settings import SETTINGS as SEARCH
from fiohost.estimation.fit import fit
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import ANGLE, Record
from fiohost.judging.metrics import Judgement
from fiohost.judging.stage import Stage
from fiohost.motor.effect import Effect, Parameter, Value
from fiohost.motor.model import Model
from fiohost.workers import each

NOT_A_STEP = 1e12
PHASES_DEG = (0.0, 60.0, 120.0)
# Orders that gears, windings and counting discs of small gear motors have.
ORDERS = (1.0, 4.0, 12.0, 48.0)
# Steps in size: so many, until so close, at most by such a factor, and by this one where nothing shows yet.
ROUNDS, CLOSE, FARTHEST, GROWTH = 16, 0.1, 10.0, 1.7
FACTORS = (1e-4, 1e4)
HALVINGS = 14
IMITATED = 1e-3
MOST_SHAPES = 3


class _Log:
    """One record's residuals and the bounds of its figures, to which a signature (n) is added."""

    def __init__(self, record: Record, judgement: Judgement, bounds: dict[str, float], lag_s: float) -> None:
        self.record, self.bounds = record, {figure: bound for figure, bound in bounds.items() if bound > 0.0}
        self.free, self.windows = judgement.free_residual, judgement.window_residual
        self.first = record.first_second()
        self.windowed = Windowed(record, lag_s)
        self.weights = record.weights**2

    def prepared(self, signature: np.ndarray) -> _Grown:
        """A signature as it shows in the free run, begun with the first second, and in windows."""
        free = signature - signature[: self.first].mean() if self.record.kind == ANGLE else signature
        return _Grown(self, free, self.windowed.clean(free))


class _Grown:
    """The figures of a log over their bounds with a prepared signature (n in the free run, n in windows) added.

    Those that are squares are polynomials of the factor on it; samples and windows are counted.
    """

    def __init__(self, log: _Log, free: np.ndarray, windows: np.ndarray) -> None:
        self.log, self.free, self.windows = log, free, windows
        weights = log.weights
        self.weight = float(weights.sum())
        self.means = np.array([weights @ log.free, weights @ free]) / self.weight
        self.squares = _products(log.free, free, weights)
        self.in_windows = _products(log.windows, windows, np.full(len(windows), 1.0 / len(windows)))

    def over(self, factor: float, enough: float = np.inf) -> tuple[float, str]:
        """The largest figure over its bound, and which it is; once one is beyond ``enough``, that one."""
        found = (0.0, "")
        for figure, of in self._figures.items():
            if figure in self.log.bounds and found[0] <= enough:
                found = max(found, (of(factor) / self.log.bounds[figure], figure))
        return found

    @cached_property
    def _figures(self) -> dict[str, Callable[[float], float]]:
        """What is found soonest comes first."""
        return {
            "free_run_rms": self._free_run_rms,
            "window_rms": lambda f: float(np.sqrt(np.array([1.0, f, f * f]) @ self.in_windows)),
            "bin_violation_pct": self._bin_violation_pct,
            "wide_windows_pct": self._wide_windows_pct,
        }

    def _offset(self, factor: float) -> float:
        """Where within its first count the angle is, as ``weigh`` has it."""
        half, mean = 0.5 * self.log.record.quantum, float(self.means @ (1.0, factor))
        return min(max(mean, -half), half) if self.log.record.kind == ANGLE else 0.0

    def _free_run_rms(self, factor: float) -> float:
        offset, mean = self._offset(factor), float(self.means @ (1.0, factor))
        square = float(self.squares @ (1.0, factor, factor**2)) / self.weight
        return float(np.sqrt(max(square - offset * (2.0 * mean - offset), 0.0)))

    def _bin_violation_pct(self, factor: float) -> float:
        log, half = self.log, 0.5 * self.log.record.quantum
        error = np.abs(log.free + factor * self.free - self._offset(factor))
        return 100.0 * float(log.weights @ (error > half)) / self.weight if half > 0.0 else 0.0

    def _wide_windows_pct(self, factor: float) -> float:
        record = self.log.record
        spans = _spans(self.log.windows + factor * self.windows, record.windows[:-1])
        return float(100.0 * np.mean(spans > SEARCH.floor.wide * record.quantum))


def _products(base: np.ndarray, added: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The weighted sum of squares of ``base`` (n) with a factor times another (n) added: its polynomial (3)."""
    return np.array([weights @ base**2, 2.0 * (weights @ (base * added)), weights @ added**2])


def largest(grown: Sequence[_Grown], factor: float = 1.0) -> tuple[float, str, str]:
    """Of a factor on a signature: the largest figure over its bound, its log and its name."""
    found = [(g.over(factor), g.log.record.name) for g in grown]
    return max((ratio, name, figure) for (ratio, figure), name in found)


def _spans(series: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """How far a series (n) goes within each window that begins at ``edges`` (m)."""
    return np.asarray(np.maximum.reduceat(series, edges) - np.minimum.reduceat(series, edges))


class Limits:
    """Detection limits around a final stage, over its training records."""

    def __init__(self, stage: Stage, records: Sequence[Record]) -> None:
        self.model, self.records = stage.fit.model, records
        here = fit(self.model, records, max_iterations=1, tolerance=NOT_A_STEP)
        self.starts, self.nuisances = here.starts, [np.linalg.qr(n)[0] for n in here.nuisances]
        columns = np.vstack(here.jacobians)
        norms = np.linalg.norm(columns, axis=0)
        self.own = np.linalg.qr(columns[:, norms > 0] / norms[norms > 0])[0]
        self.edges = np.cumsum([0, *(len(r) for r in records)])
        lag_s = self.model.number("linear.tau_s")
        self.logs = [
            _Log(r, j, {e.figure: e.allowed for e in stage.excesses if e.record == r.name}, lag_s)
            for r, j in zip(records, stage.judgements, strict=True)
        ]

    def outputs(self, model: Model) -> list[np.ndarray]:
        flat = Flat.of(model)
        return [free_output(r, flat, s) for r, s in zip(self.records, self.starts, strict=True)]

    def signature(self, model: Model, base: Sequence[np.ndarray]) -> tuple[list[np.ndarray], float]:
        """What is left (n each) of a model's difference from ``base`` once the own parameters have taken theirs, and
        the share of it that is left.

        The base of an effect is that effect at no size, so that its finer steps in time do not count.
        """
        change = [r.weights * (y - b) for r, y, b in zip(self.records, self.outputs(model), base, strict=True)]
        whole = np.concatenate([c - q @ (q.T @ c) for c, q in zip(change, self.nuisances, strict=True)])
        left = whole - self.own @ (self.own.T @ whole)
        raw = float(np.sqrt(sum(float(c @ c) for c in change)))
        parts = [left[a:b] / r.weights for r, a, b in zip(self.records, self.edges[:-1], self.edges[1:], strict=True)]
        return parts, float(np.linalg.norm(left)) / raw if raw > 0 else 0.0

    def prepared(self, parts: Sequence[np.ndarray]) -> list[_Grown]:
        """A signature (n each) as it shows in every log."""
        return [log.prepared(p) for log, p in zip(self.logs, parts, strict=True)]

    def factor(self, parts: Sequence[np.ndarray]) -> tuple[float, str, str]:
        """The smallest factor by which a signature is seen, infinite where none is; with log and figure."""
        grown = self.prepared(parts)

        def seen(factor: float) -> bool:
            return any(g.over(factor, 1.0)[0] > 1.0 for g in grown)

        low, high = np.log(FACTORS)
        if not seen(float(np.exp(high))):
            return np.inf, "", ""
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if seen(float(np.exp(middle))) else (middle, high)
        _, log, figure = largest(grown, float(np.exp(high)))
        return float(np.exp(high)), log, figure

    def of(self, effect: Effect) -> list[Limit]:
        """The limits of one effect: one for each of its choices and orders."""
        trials = effect.tried(span_of(self.records))
        sizes = [p for p in effect.parameters if p.neutral is not None and p.is_smooth]
        if sizes:
            return [self._typical(effect, sizes, group) for group in _groups(effect, trials, sizes)]
        return [self._there_or_not(effect, group) for group in _groups(effect, trials, sizes)]

    def _there_or_not(self, effect: Effect, trials: Sequence[Trial]) -> Limit:
        """An effect without a size: the finest of a whole number that is seen, else how many of its cases are."""
        first = effect.parameters[0]
        seen = []
        base = self.outputs(self.model)
        for trial in trials:
            parts, _ = self.signature(self.model.with_effect(effect.name, trial), base)
            ratio, log, figure = largest(self.prepared(parts))
            if ratio > 1.0:
                seen.append((ratio, trial, log, figure))
        if not seen or not first.whole:
            reason = f"{len(seen)} of the {len(trials)} cases tried would be seen"
            return Limit(effect.name, first.name, first.unit, None, None, {}, reason=reason)
        _, trial, log, figure = min(seen, key=lambda s: s[0])
        rest = {k: v for k, v in trial.items() if k != first.name}
        return Limit(effect.name, first.name, first.unit, float(trial[first.name]), None, rest, log, figure)

    def _typical(self, effect: Effect, sizes: Sequence[Parameter], trials: Sequence[Trial]) -> Limit:
        """The worst over phases, and the middle one over everything else that is not known."""
        by_shape: dict[tuple[Value, ...], list[Trial]] = {}
        apart = [*(p.name for p in effect.parameters if p.period is not None), *(p.name for p in sizes)]
        for trial in trials:
            shape = tuple(v for k, v in trial.items() if k not in apart)
            by_shape.setdefault(shape, []).append(trial)
        picked = np.unique(np.linspace(0, len(by_shape) - 1, MOST_SHAPES).round().astype(int))

        def distance(limit: Limit) -> float:
            return np.inf if limit.value is None else abs(limit.value - float(sizes[0].neutral or 0.0))

        of_shape = [[self.sized(effect, sizes, t) for t in list(by_shape.values())[i]] for i in picked]
        worst = sorted((max(found, key=distance) for found in of_shape), key=distance)
        return worst[(len(worst) - 1) // 2]

    def sized(self, effect: Effect, sizes: Sequence[Parameter], trial: Trial) -> Limit:
        """The smallest visible size of an effect whose other parameters are those of a trial.

        Several sizes grow together. Sizes in multiples of the trial's are narrowed down between the largest that is
        not seen and the smallest that is, by the factor that the signature of the last one lacks.
        """
        first = sizes[0]
        model = self.model.with_effect(effect.name, trial)
        none = {p.name: float(p.neutral or 0.0) for p in sizes}
        full = {p.name: float(trial[p.name]) - none[p.name] for p in sizes}
        most = min(abs(((p.upper if full[p.name] > 0 else p.lower) - none[p.name]) / full[p.name]) for p in sizes)
        base = self.outputs(self.with_sizes(model, effect, none))

        def at(reach: float) -> Trial:
            grown = {p.name: none[p.name] + reach * full[p.name] for p in sizes}
            return {p.name: float(np.clip(grown[p.name], p.lower, p.upper)) for p in sizes}

        def limit(value: float | None, log: str = "", figure: str = "", reason: str | None = None) -> Limit:
            rest = {k: v for k, v in trial.items() if k != first.name}
            if value is not None:
                rest |= {k: v for k, v in at(value).items() if k != first.name}
            shown = None if value is None else float(at(value)[first.name])
            return Limit(effect.name, first.name, first.unit, shown, none[first.name], rest, log, figure, reason)

        reach, unseen, seen, left, log, figure = 1.0, 0.0, np.inf, 0.0, "", ""
        for _ in range(ROUNDS):
            parts, left = self.signature(self.with_sizes(model, effect, at(reach)), base)
            factor, where, what = self.factor(parts) if left > 0 else (np.inf, "", "")
            if np.isfinite(factor):
                log, figure = where, what
            unseen, seen = (max(unseen, reach), seen) if factor > 1.0 else (unseen, reach)
            if abs(np.log(factor)) < CLOSE and reach * factor <= most:
                return limit(reach * factor, log, figure)
            if seen < unseen * (1.0 + CLOSE):
                break
            if reach >= most and factor > 1.0:
                break
            wanted = reach * (min(max(factor, 1.0 / FARTHEST), FARTHEST) if np.isfinite(factor) else GROWTH)
            if not unseen < wanted < seen:
                wanted = float(np.sqrt(max(unseen, 1e-3 * seen) * seen))
            reach = min(wanted, most)
        if np.isfinite(seen):
            return limit(seen, log, figure)
        if left == 0.0:
            return limit(None, reason="it changes nothing in these logs")
        imitated = left < IMITATED
        return limit(
            None, reason="the model's own parameters imitate it" if imitated else "even its largest size is hidden"
        )

    @staticmethod
    def with_sizes(model: Model, effect: Effect, sizes: Mapping[str, Value]) -> Model:
        return model.with_values({f"{effect.name}.{name}": value for name, value in sizes.items()})


def _groups(effect: Effect, trials: Sequence[Trial], sizes: Sequence[Parameter]) -> list[list[Trial]]:
    """Trials that differ in neither choice nor order, every phase with each, those equal but for size once."""
    phase = next((p.name for p in effect.parameters if p.period is not None), None)
    sized = [p.name for p in sizes]
    groups: dict[tuple[Value, ...], list[Trial]] = {}
    known: set[tuple[Value, ...]] = set()
    for trial in trials:
        if "order" in trial and trial["order"] not in ORDERS:
            continue
        for turned in PHASES_DEG if phase else (0.0,):
            full = {**trial, phase: turned} if phase else trial
            key = tuple(v for k, v in full.items() if k not in sized)
            if key in known:
                continue
            known.add(key)
            kind = tuple(full[p.name] for p in effect.parameters if p.is_choice or p.name == "order")
            groups.setdefault(kind, []).append(full)
    return list(groups.values())


def detection_limits(stage: Stage, records: Sequence[Record], library: Sequence[str] | None = None) -> list[Limit]:
    """What size of each effect of the library these records would have shown beside the final model."""
    limits = Limits(stage, records)
    offered = [e for e in candidates(limits.model, records, library, span_of(records)) if not e.points]  # no one size
    return [limit for found in each(limits.of, offered) for limit in found]
