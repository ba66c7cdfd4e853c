"""Which effects could account for the residual: the score test, one simulation a trial.

The signature of an effect is what adding it at a trial size changes in what was fitted, whole runs or windows, with
everything that the model's own parameters and the initial states could imitate projected out. The share of the
residual's power along it is its score.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.logs.lines import Series, clock_lines
from fiohost.discover.logs.offered import span_of
from fiohost.discover.logs.scores import Direction, Score, _scaled, powers
from fiohost.discover.settings import SETTINGS
from fiohost.discover.trials import Trial, varied
from fiohost.estimation.fit import Fit
from fiohost.estimation.predict import Flat, errors, squared, windowed
from fiohost.estimation.record import Record
from fiohost.estimation.tangent import Tangent
from fiohost.judging.missing_torque import missing_torque
from fiohost.motor.effect import Effect

SCREEN = SETTINGS.screen
# So many trials are whitened together: more would only fill the memory.
TOGETHER = 8


class Screen:
    """Signatures of candidates around one fit, and the residual they are held against, over all records (n)."""

    def __init__(self, fit: Fit, records: Sequence[Record], lines_hz: Sequence[float] | None = None) -> None:
        """``lines_hz`` are those of the clock in what is left; None: they are looked for."""
        self.fit = fit
        self.records = records
        flat = Flat.of(fit.model)
        self._blocks = [max(1, round(SCREEN.resolution_s / r.sample_time_s)) for r in records]
        steps_s = [n * r.sample_time_s for r, n in zip(records, self._blocks, strict=True)]
        samples = [r.edges[-1] if fit.windows else len(r) for r in records]
        self.lengths = [k // n for k, n in zip(samples, self._blocks, strict=True)]
        pairs = list(zip(records, fit.starts, strict=True))
        self._base = [] if fit.windows else [errors(r, flat, s) for r, s in pairs]
        self._tangents = [Tangent(r, flat, s, windowed(r, flat, s)[1]) for r, s in pairs] if fit.windows else []
        self._nuisances = [np.linalg.qr(n)[0] if n.shape[1] else n for n in self.coarse(fit.nuisances)]
        jacobian = np.vstack(self.coarse(fit.jacobians)) if fit.names else np.empty((sum(self.lengths), 0))
        norms = np.linalg.norm(jacobian, axis=0)
        self._names = [n for n, there in zip(fit.names, norms > 0, strict=True) if there]
        self._own, triangle = np.linalg.qr(jacobian[:, norms > 0] / norms[norms > 0])
        # What the model's own parameters would have to take back of a change (m), by name.
        self._take = np.linalg.pinv(triangle, rcond=1e-9) / norms[norms > 0][:, None]
        self.residual = self.clean([r for r in fit.residuals])
        self.power = float(self.residual @ self.residual)
        if lines_hz is None:
            lines_hz = clock_lines(self._missing(steps_s))
        self.span = replace(span_of(records), lines_hz=tuple(lines_hz))
        # A line is the largest of as many frequencies as the longest record tells apart.
        self.by_lines = SCREEN.line_chance * np.log(100.0 * max(self.lengths)) if self.span.lines_hz else 0.0
        common = np.array([not r.own_zero for r in records])
        alone = [np.arange(len(records)) == i for i in np.flatnonzero(~common)]
        self._zeros = [*([common] if common.any() else []), *alone]

    def _missing(self, steps_s: Sequence[float]) -> list[Series]:
        """The torque that the model lacks in free runs of the records, and their commands."""
        flat, left = Flat.of(self.fit.model), []
        for record, start in zip(self.records, self.fit.starts, strict=True):
            error = errors(record, flat, start) / record.weights
            left.append(missing_torque(record, self.fit.model, error))
        torques, duties = self.coarse(left), self.coarse([r.acting_pct for r in self.records])
        clocks = [r.excitation.clock_s for r in self.records]
        return [Series(*found) for found in zip(torques, duties, steps_s, clocks, strict=True)]

    def coarse(self, series: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Means of each record's series (n, ...) over blocks of about the screen's resolution."""
        found = []
        for values, n in zip(series, self._blocks, strict=True):
            count = len(values) // n
            blocks = values[: count * n].reshape(count, n, *values.shape[1:])
            found.append(np.einsum("ij...->i...", blocks) / n if n > 1 else values)
        return found

    def window_edges(self) -> np.ndarray:
        """Where (m) in the series of all records as one the windows begin."""
        firsts, at = [], 0
        for record, n, length in zip(self.records, self._blocks, self.lengths, strict=True):
            begins = np.unique(record.edges[:-1] // n)
            firsts.append(at + begins[begins < length])
            at += length
        return np.concatenate(firsts)

    def _started(self, series: Sequence[np.ndarray]) -> np.ndarray:
        """Series of all records as one (m), without what initial states can imitate."""
        return np.concatenate([s - q @ (q.T @ s) for s, q in zip(self.coarse(series), self._nuisances, strict=True)])

    def clean(self, series: Sequence[np.ndarray]) -> np.ndarray:
        """Series of all records as one (m), without what initial states and the model's parameters can imitate."""
        flat = self._started(series)
        return np.asarray(flat - self._own @ (self._own.T @ flat))

    def _beside(self, changes: Sequence[Sequence[np.ndarray]], factors: Sequence[float] | np.ndarray) -> Trial:
        """The model's own parameters where changes (n each) that have grown by ``factors`` leave them."""
        grown = [f * (self._own.T @ self._started(change)) for change, f in zip(changes, factors, strict=True)]
        moved = self._take @ np.sum(grown, axis=0)
        found: Trial = {}
        for name, step in zip(self._names, moved, strict=True):
            bounds, value = self.fit.model.parameter(name), self.fit.model.number(name)
            found[name] = float(np.clip(value - step, bounds.lower, bounds.upper)) if np.isfinite(step) else value
        return found

    def signature(self, effect: Effect, trial: Trial) -> np.ndarray:
        """What adding an effect at a trial size changes (n), cleaned; zero where nothing of its own is left."""
        return self._cleaned(next(self._changes(effect, [trial])))

    def _changes(self, effect: Effect, trials: Sequence[Trial]) -> Iterator[list[np.ndarray]]:
        """What adding an effect at each of some trial sizes changes, by record (n each)."""
        starts = self.fit.starts
        for i in range(0, len(trials), TOGETHER):
            some = trials[i : i + TOGETHER]
            flats = [Flat.of(self.fit.model.with_effect(effect.name, t)) for t in some]
            if self._tangents:
                by = [t.by_each([(f, s, 1.0) for f in flats]) for t, s in zip(self._tangents, starts, strict=True)]
                yield from ([columns[:, j] for columns in by] for j in range(len(some)))
                continue
            for flat in flats:
                base = zip(self.records, starts, self._base, strict=True)
                yield [b - errors(r, flat, s) for r, s, b in base]

    def _cleaned(self, change: Sequence[np.ndarray]) -> np.ndarray:
        cleaned = self.clean(change)
        raw = np.sqrt(squared(change))  # infinite of a trial that runs away
        return cleaned if float(np.linalg.norm(cleaned)) > 1e-6 * raw else np.zeros_like(cleaned)

    def _single(self, effect: Effect, trial: Trial, change: Sequence[np.ndarray], one_sided: bool) -> Direction:
        signature = self._cleaned(change)
        size = float(np.linalg.norm(signature))
        if size == 0.0 or self.power == 0.0:
            return Direction(trial, np.zeros((len(signature), 1), dtype=np.float32), 0.0)
        along = float(signature @ self.residual) / size
        share = along * along / self.power if along > 0.0 or not one_sided else 0.0
        as_it_is = (2.0 * along * size - size * size) / self.power
        unit = (signature / size)[:, None].astype(np.float32)
        grown, factor = _scaled(effect, trial, along / size)
        return Direction(grown, unit, share, as_it_is=as_it_is, own=self._beside([change], [factor]))

    def _swinging(self, effect: Effect, trial: Trial) -> Direction:
        """Every size of an effect by a sine and a cosine together: any phase, so any sign; bound to the angle, a phase
        for each zero of it.
        """
        zeros = self._zeros if effect.angle_bound else [np.ones(len(self.records), dtype=bool)]
        sizes = {size: float(trial[size]) for size, _ in effect.couples}
        swings: list[list[np.ndarray]] = []
        for size, phase in effect.couples:
            alone = {**trial, **dict.fromkeys(sizes, 0.0), size: sizes[size]}
            changes = list(self._changes(effect, [{**alone, phase: degrees} for degrees in (0.0, 90.0)]))
            swings += [
                [c if there else 0.0 * c for c, there in zip(change, zero, strict=True)]
                for zero in zeros
                for change in changes
            ]
        both = np.column_stack([self._cleaned(change) for change in swings])
        shape = (len(sizes), len(zeros))
        if self.power == 0.0 or np.any(np.linalg.norm(both, axis=0) == 0.0):
            return Direction(trial, np.zeros(both.shape, dtype=np.float32), 0.0, np.ones(shape))
        basis, triangle = np.linalg.qr(both)
        along = basis.T @ self.residual
        factors = np.linalg.lstsq(triangle, along, rcond=None)[0]
        pairs = factors.reshape(*shape, 2)
        weights = np.linalg.norm(triangle.reshape(len(triangle), *shape, 2), axis=(0, 3))
        weights /= np.linalg.norm(weights, axis=1, keepdims=True)
        grown = dict(trial)
        for i, (size, phase) in enumerate(effect.couples):
            bounds = effect.parameter(size)
            factor = float(weights[i] ** 2 @ np.hypot(pairs[i, :, 0], pairs[i, :, 1]))
            grown[size] = float(np.clip(factor * sizes[size], bounds.lower, bounds.upper))
            grown[phase] = float(np.degrees(np.arctan2(pairs[i, 0, 1], pairs[i, 0, 0])))
        share = float(powers(along[None, :], weights)[0]) / self.power
        return Direction(grown, basis.astype(np.float32), share, weights, own=self._beside(swings, factors))

    def _curved(self, effect: Effect, trial: Trial) -> Direction:
        """A curve of any shape: each of its points alone, and what the residual asks of all of them together."""
        alone = [{**trial, **{p: trial[p] if p == point else 0.0 for p in effect.points}} for point in effect.points]
        changes = list(self._changes(effect, alone))
        signatures = np.column_stack([self._cleaned(change) for change in changes])
        basis, triangle = np.linalg.qr(signatures)
        if self.power == 0.0 or np.any(np.abs(np.diag(triangle)) <= 1e-6 * np.abs(triangle).max()):
            return Direction(trial, np.zeros(signatures.shape, dtype=np.float32), 0.0)
        along = basis.T @ self.residual
        grown, factors = dict(trial), np.linalg.solve(triangle, along)
        for point, factor in zip(effect.points, factors, strict=True):
            bounds = effect.parameter(point)
            grown[point] = float(np.clip(factor * float(trial[point]), bounds.lower, bounds.upper))
        share, own = float(along @ along) / self.power, self._beside(changes, factors)
        return Direction(grown, basis.astype(np.float32), share, own=own)

    def score(self, effect: Effect) -> Score:
        """Best share of the residual's power over the effect's trials, with the sign that physics allows."""
        trials = effect.tried(self.span)
        if effect.couples:
            found = [self._swinging(effect, t) for t in trials]
        elif effect.points:
            found = [self._curved(effect, t) for t in trials]
        else:
            sized = [p for p in effect.parameters if p.neutral is not None]
            one_sided = bool(sized) and all(p.lower >= p.neutral or p.upper <= p.neutral for p in sized)  # type: ignore[operator]
            changes = self._changes(effect, trials)
            found = [self._single(effect, t, c, one_sided) for t, c in zip(trials, changes, strict=True)]
        order = sorted(range(len(found)), key=lambda i: found[i].share, reverse=True)
        grown = bool(effect.couples or effect.points)  # a trial as the library has it says nothing of their shape
        starts: list[tuple[Trial, Trial]] = []
        far = [self.fit.windows and d.as_it_is < -SETTINGS.hopeless for d in found]
        # What swings often has other orders that do nearly as much: no gradient leads from one to the next.
        tied = sum(grown and d.share >= SCREEN.tied * found[order[0]].share for d in found)
        for i in varied(effect, trials, order)[: max(SCREEN.best_trials, tied)]:
            scaled = grown or found[i].trial != trials[i]
            if scaled or not far[i]:
                starts.append((found[i].trial, found[i].own))
            if scaled and not (grown or far[i]):
                starts.append((trials[i], {}))
        share = found[order[0]].share if found else 0.0
        by_size = sorted(range(len(found)), key=lambda i: found[i].as_it_is, reverse=True)
        raw = () if grown else tuple(trials[i] for i in by_size)
        begun, own = zip(*starts, strict=True) if starts else ((), ())
        away = tuple(t for t, is_far in zip(trials, far, strict=True) if is_far)
        return Score(effect, share, begun, tuple(found[i] for i in order), raw, own, away)
