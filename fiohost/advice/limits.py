"""How small an effect would still have been seen in these data: detection limits where nothing is missing.

An effect is put into the final model at a size, the model's own parameters take what they can of it, and the rest is
added to the residual that is there. The limit is the size at which a figure of a log passes the bound that the verdict
holds it against: from there on the data would not have been called complete.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fiohost.advice.grown import Grown, Log, Seen, largest, smallest
from fiohost.advice.limit import Limit
from fiohost.discover.logs.offered import candidates, span_of
from fiohost.discover.trials import Trial
from fiohost.estimation.fit import fit
from fiohost.estimation.predict import Flat, free_output, squared
from fiohost.estimation.record import Record
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
IMITATED = 1e-3
MOST_SHAPES = 3


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
            Log(r, j, {e.figure: e.allowed for e in stage.excesses if e.record == r.name}, lag_s)
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
        raw = float(np.sqrt(squared(change)))  # infinite of a trial that runs away
        parts = [left[a:b] / r.weights for r, a, b in zip(self.records, self.edges[:-1], self.edges[1:], strict=True)]
        return parts, float(np.linalg.norm(left)) / raw if raw > 0 else 0.0

    def grown(self, parts: Sequence[np.ndarray]) -> list[Grown]:
        """A signature (n each) as it shows in every log."""
        return [log.grown(p) for log, p in zip(self.logs, parts, strict=True)]

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
            ratio, log, figure = largest(self.grown(parts))
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

        worst, reach = list[Limit](), 1.0
        for alike in (list(by_shape.values())[i] for i in picked):
            found = list[Limit]()
            for trial in alike:
                found.append(self.sized(effect, sizes, trial, reach))
                # The next differs by its phase or its shape: its limit is not far.
                share = distance(found[-1]) / abs(float(trial[sizes[0].name]) - float(sizes[0].neutral or 0.0))
                reach = share if np.isfinite(share) else reach
            worst.append(max(found, key=distance))
        worst.sort(key=distance)
        return worst[(len(worst) - 1) // 2]

    def sized(self, effect: Effect, sizes: Sequence[Parameter], trial: Trial, reach: float = 1.0) -> Limit:
        """The smallest visible size of an effect whose other parameters are those of a trial, looked for from a
        multiple of the trial's.

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

        reach, unseen, seen, left, log, figure = min(reach, most), 0.0, np.inf, 0.0, "", ""
        for _ in range(ROUNDS):
            parts, left = self.signature(self.with_sizes(model, effect, at(reach)), base)
            factor, where, what = smallest(self.grown(parts)) if left > 0 else Seen()
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
