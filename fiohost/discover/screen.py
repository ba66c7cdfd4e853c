"""Which effects could account for the residual: the score test, one simulation a trial.

The signature of an effect is what adding it at a trial size changes in what was fitted, whole runs or windows, with
everything that the model's own parameters and the initial states could imitate projected out. The share of the
residual's power along it is its score.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.estimation.fit import Fit
from fiohost.estimation.predict import Flat, errors, windowed
from fiohost.estimation.record import ANGLE, Record
from fiohost.estimation.tangent import Tangent
from fiohost.motor.effect import Effect, Span, Value, effects
from fiohost.motor.model import Model

# Signatures are compared at this resolution in time: a shaft does not move faster, and arrays stay small.
RESOLUTION_S = 0.02
BEST_TRIALS = 4
# A shaft that stands for so long though driven on by more than friction may stand at an end of travel.
DRIVEN_ON_PCT, HELD_S = 10.0, 0.15
# So does one that comes with so many counts in two samples, and stands at once for so many samples.
ABRUPT_COUNTS, STANDS = 4.0, 5

Trial = dict[str, Value]


@dataclass(frozen=True)
class Direction:
    """One way in which an effect may act: trial values, and the orthonormal signatures (n, k) they leave.

    ``share`` is the part of the residual's power along them, zero where physics forbids the sign; ``as_it_is`` what the
    trial removes of that power at the size that it has. Of an effect bound to
    the angle there is a sine and a cosine for each zero of angle that the logs have: one size, a phase each, so
    ``weights`` are the sizes that belong together (none: one).
    """

    trial: Trial
    basis: np.ndarray
    share: float
    weights: tuple[float, ...] = (1.0,)
    as_it_is: float = 0.0


@dataclass(frozen=True)
class Score:
    """One effect against the residual: its directions, best first, and the trials from which to refit it.

    ``raw`` are the trials as the library gives them, the best first: a size that grows from nothing says little of an
    effect whose other parameters shape it.
    """

    effect: Effect
    share: float
    trials: tuple[Trial, ...]
    directions: tuple[Direction, ...]
    raw: tuple[Trial, ...] = ()


def candidates(model: Model, records: Sequence[Record], library: Sequence[str] | None = None) -> list[Effect]:
    """Effects that may be added to a model: those of the library that are not in it and can act on such records."""
    names = effects() if library is None else library
    rotary = all(r.rotary and r.kind == ANGLE for r in records)
    chosen = [effects()[n] for n in names if n != "linear" and n not in model.effects]
    span = span_of(records)
    trying = [e for e in chosen if e.trials or (e.trials_for and e.trials_for(span))]
    return [e for e in trying if rotary or not e.angle_bound]


def span_of(records: Sequence[Record]) -> Span:
    """What the records cover."""
    begin = min(r.excitation.clock_s for r in records)
    end = max(r.excitation.clock_s + r.seconds for r in records)
    ends = [end for r in records if r.kind == ANGLE for end in _ends(r)]
    return Span((begin, end), tuple(ends))


def _ends(record: Record) -> list[float]:
    """Where a record's shaft stood at its extreme angle though driven on, or came to stand there at once from speed; a
    count's middle.
    """
    found = []
    duty = record.acting_pct
    for side in (1.0, -1.0):
        outward = side * record.y
        there = outward >= outward.max() - 1.01 * record.quantum
        held = np.count_nonzero(there & (side * duty > DRIVEN_ON_PCT)) * record.sample_time_s >= HELD_S
        first = int(np.argmax(there))
        came = outward[first - 1] - outward[first - 3] >= ABRUPT_COUNTS * record.quantum if first >= 3 else False
        if held or (came and there[first : first + STANDS].all()):
            found.append(side * float(outward.max()) + 0.5 * record.quantum)
    return found


class Screen:
    """Signatures of candidates around one fit, and the residual they are held against, over all records (n)."""

    def __init__(self, fit: Fit, records: Sequence[Record]) -> None:
        self.fit = fit
        self.records = records
        self.span = span_of(records)
        flat = Flat.of(fit.model)
        self._blocks = [max(1, round(RESOLUTION_S / r.sample_time_s)) for r in records]
        self.lengths = [len(r) // n for r, n in zip(records, self._blocks, strict=True)]
        pairs = list(zip(records, fit.starts, strict=True))
        self._base = [] if fit.windows else [errors(r, flat, s) for r, s in pairs]
        self._tangents = [Tangent(r, flat, s, windowed(r, flat, s)[1]) for r, s in pairs] if fit.windows else []
        self._nuisances = [np.linalg.qr(n)[0] if n.shape[1] else n for n in self.coarse(fit.nuisances)]
        jacobian = np.vstack(self.coarse(fit.jacobians)) if fit.names else np.empty((sum(self.lengths), 0))
        norms = np.linalg.norm(jacobian, axis=0)
        self._own, _ = np.linalg.qr(jacobian[:, norms > 0] / norms[norms > 0])
        self.residual = self.clean([r for r in fit.residuals])
        self.power = float(self.residual @ self.residual)
        common = np.array([not r.own_zero for r in records])
        alone = [np.arange(len(records)) == i for i in np.flatnonzero(~common)]
        self._zeros = [*([common] if common.any() else []), *alone]

    def coarse(self, series: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Means of each record's series (n, ...) over blocks of about the screen's resolution."""
        found = []
        for values, n in zip(series, self._blocks, strict=True):
            count = len(values) // n
            found.append(values[: count * n].reshape(count, n, *values.shape[1:]).mean(axis=1) if n > 1 else values)
        return found

    def clean(self, series: Sequence[np.ndarray]) -> np.ndarray:
        """Series of all records as one (m), without what initial states and the model's parameters can imitate."""
        parts = [s - q @ (q.T @ s) for s, q in zip(self.coarse(series), self._nuisances, strict=True)]
        flat = np.concatenate(parts)
        return np.asarray(flat - self._own @ (self._own.T @ flat))

    def signature(self, effect: Effect, trial: Trial) -> np.ndarray:
        """What adding an effect at a trial size changes (n), cleaned; zero where nothing of its own is left."""
        return self._cleaned(self._change(effect, trial))

    def _change(self, effect: Effect, trial: Trial) -> list[np.ndarray]:
        flat = Flat.of(self.fit.model.with_effect(effect.name, trial))
        if self._tangents:
            return [t.by(flat, s, 1.0) for t, s in zip(self._tangents, self.fit.starts, strict=True)]
        return [b - errors(r, flat, s) for r, s, b in zip(self.records, self.fit.starts, self._base, strict=True)]

    def _cleaned(self, change: Sequence[np.ndarray]) -> np.ndarray:
        cleaned = self.clean(change)
        raw = float(np.sqrt(sum(float(c @ c) for c in change)))
        return cleaned if float(np.linalg.norm(cleaned)) > 1e-6 * raw else np.zeros_like(cleaned)

    def _single(self, effect: Effect, trial: Trial, one_sided: bool) -> Direction:
        signature = self.signature(effect, trial)
        size = float(np.linalg.norm(signature))
        if size == 0.0 or self.power == 0.0:
            return Direction(trial, np.zeros((len(signature), 1), dtype=np.float32), 0.0)
        along = float(signature @ self.residual) / size
        share = along * along / self.power if along > 0.0 or not one_sided else 0.0
        as_it_is = (2.0 * along * size - size * size) / self.power
        unit = (signature / size)[:, None].astype(np.float32)
        return Direction(_scaled(effect, trial, along / size), unit, share, as_it_is=as_it_is)

    def _pair(self, effect: Effect, sine: Trial, cosine: Trial) -> Direction:
        """A sine and a cosine together: any phase, so any sign; a phase for each zero of angle."""
        changes = [self._change(effect, t) for t in (sine, cosine)]
        columns = [
            self._cleaned([c if there else 0.0 * c for c, there in zip(change, zero, strict=True)])
            for zero in self._zeros
            for change in changes
        ]
        both = np.column_stack(columns)
        if self.power == 0.0 or np.any(np.linalg.norm(both, axis=0) == 0.0):
            return Direction(sine, np.zeros((len(both), 2), dtype=np.float32), 0.0)
        basis, triangle = np.linalg.qr(both)
        along = basis.T @ self.residual
        pairs = np.linalg.lstsq(triangle, along, rcond=None)[0].reshape(-1, 2)
        weights = np.linalg.norm(triangle.reshape(len(triangle), -1, 2), axis=(0, 2))
        weights /= np.linalg.norm(weights)
        size = next(p for p in effect.parameters if p.neutral is not None and p.is_smooth)
        phase = next(p for p in effect.parameters if p.period is not None)
        factor = float(weights**2 @ np.hypot(pairs[:, 0], pairs[:, 1]))
        level = float(np.clip(factor * float(sine[size.name]), size.lower, size.upper))
        a, b = pairs[0]
        trial: Trial = {**sine, size.name: level, phase.name: float(np.degrees(np.arctan2(b, a)))}
        share = float(powers(along[None, :], weights)[0]) / self.power
        return Direction(trial, basis.astype(np.float32), share, tuple(weights))

    def score(self, effect: Effect) -> Score:
        """Best share of the residual's power over the effect's trials, with the sign that physics allows."""
        trials = [dict(t) for t in (effect.trials_for(self.span) if effect.trials_for else effect.trials)]
        if effect.linear_pairs:
            found = [self._pair(effect, a, b) for a, b in zip(trials[::2], trials[1::2], strict=True)]
        else:
            sized = [p for p in effect.parameters if p.neutral is not None]
            one_sided = bool(sized) and all(p.lower >= p.neutral or p.upper <= p.neutral for p in sized)  # type: ignore[operator]
            found = [self._single(effect, t, one_sided) for t in trials]
        order = sorted(range(len(found)), key=lambda i: found[i].share, reverse=True)
        starts: list[Trial] = []
        for i in varied(effect, trials, order)[:BEST_TRIALS]:
            starts.append(found[i].trial)
            if not effect.linear_pairs and found[i].trial != trials[i]:
                starts.append(trials[i])
        share = found[order[0]].share if found else 0.0
        by_size = sorted(range(len(found)), key=lambda i: found[i].as_it_is, reverse=True)
        raw = () if effect.linear_pairs else tuple(trials[i] for i in by_size)
        return Score(effect, share, tuple(starts), tuple(found[i] for i in order), raw)


def powers(along: np.ndarray, weights: Sequence[float] | np.ndarray) -> np.ndarray:
    """Power (draws) of projections (draws, k) along signatures whose sizes belong together, ``weights`` being those
    of equal groups of them.
    """
    if len(weights) == 1:
        return np.asarray((along**2).sum(axis=1, dtype=np.float64))
    groups = np.linalg.norm(along.reshape(len(along), len(weights), -1), axis=2)
    return np.asarray((groups @ np.asarray(weights)) ** 2)


def varied(effect: Effect, trials: Sequence[Trial], order: Sequence[int]) -> list[int]:
    """The order of trials with the best of each choice first: no choice is lost because another scores higher."""
    if effect.linear_pairs:
        return list(order)
    kinds = [tuple(trials[i][p.name] for p in effect.parameters if p.is_choice) for i in range(len(trials))]
    first = [i for n, i in enumerate(order) if kinds[i] not in [kinds[j] for j in order[:n]]]
    return [*first, *(i for i in order if i not in first)]


def _scaled(effect: Effect, trial: Trial, factor: float) -> Trial:
    """A trial grown to the size that the residual asks for, within bounds; as it is where it has no single size."""
    sized = [p for p in effect.parameters if p.neutral is not None and p.is_smooth]
    if len(sized) != 1 or not np.isfinite(factor):
        return trial
    parameter = sized[0]
    neutral = float(parameter.neutral or 0.0)
    value = neutral + factor * (float(trial[parameter.name]) - neutral)
    return {**trial, parameter.name: float(np.clip(value, parameter.lower, parameter.upper))}
