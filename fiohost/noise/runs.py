"""What differs from run to run: random effects of the runs, a mean and a scatter each (Laird and Ware 1982).

Gain and dry friction scatter as shares of themselves, an offset of the torque in percent of duty. Little is needed of a
run: how what is left pulls at each of them, and how well it knows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.special import fdtri, stdtr

from fiohost.motor.hooks import EFFECT_INDEX
from fiohost.motor.model import Model, slot
from fiohost.noise.settings import SETTINGS, NoiseSettings

GAIN, FRICTION, LOAD = 0, 1, 2
LOAD_EFFECT = "constant_load"
# Friction or gain of which next to nothing is left in a run has no derivative there.
LEAST_GROWTH = 0.05
FRICTIONS = (
    "coulomb_friction.level_pct",
    "asymmetric_coulomb_friction.forward_pct",
    "asymmetric_coulomb_friction.reverse_pct",
)

_GAIN, _LOAD = slot("linear.gain_deg_s_per_pct"), slot(f"{LOAD_EFFECT}.level_pct")
_FRICTIONS = [slot(name) for name in FRICTIONS]


@dataclass(frozen=True)
class Pull:
    """A run as its random effects see it: the information (3, 3) on them, and the score (3), both whitened."""

    information: np.ndarray
    score: np.ndarray

    def __add__(self, other: Pull) -> Pull:
        return Pull(self.information + other.information, self.score + other.score)


NO_PULL = Pull(np.zeros((3, 3)), np.zeros(3))


@dataclass(frozen=True)
class RunToRun:
    """Standard deviations (3) of gain (share), dry friction (share) and offset load (percent of duty) over runs, their
    95 % intervals (3, 2), and by run the most likely values (3), shrunk to none by what the run does not say;
    ``common_load`` is the runs' mean load over its standard error, and that ``load_error_pct``; nil where the load does
    not scatter.
    """

    sd: np.ndarray
    ci95: np.ndarray
    by_run: dict[str, np.ndarray] = field(default_factory=dict)
    common_load: float = 0.0
    load_error_pct: float = 0.0

    @property
    def known(self) -> bool:
        return bool(np.any(self.sd > 0.0))

    @property
    def about_model(self) -> np.ndarray:
        """Scatter (3) about what the model says, not about the runs' own mean: where no name takes up an offset that
        runs have in common, another day's runs have as much.
        """
        if not (self.known and self.by_run):
            return self.sd
        rms = np.sqrt(np.mean(np.square(list(self.by_run.values())), axis=0))
        return np.where(self.sd > 0.0, np.maximum(self.sd, rms), 0.0)

    def shares_load(self, chance: float) -> bool:
        """Whether the runs have a load in common (Student 1908), but for so small a ``chance``: it does not differ."""
        free = len(self.by_run) - 1
        return free > 0 and 2.0 * float(stdtr(free, -abs(self.common_load))) < chance

    def load_by_chance(self, level_pct: float, times: float) -> bool:
        """Whether runs differ in their loads, and a ``level_pct`` that these have in common is within so many ``times``
        the 99 % point of what the mean of so few has of none, in deviance (Student 1908).
        """
        free, error = len(self.by_run) - 1, self.load_error_pct
        return error > 0.0 and free > 0 and (level_pct / error) ** 2 <= times * float(fdtri(1, free, 0.99))

    def likely_sd(self, rng: np.random.Generator) -> np.ndarray:
        """``sd`` (3) as it may be, one draw: few runs say little of how they scatter (Student 1908). What they have in
        common is what an effect would explain: chance has none of it.
        """
        free = max(len(self.by_run) - 1, 1)
        return np.asarray(self.sd * np.sqrt(free / rng.chisquare(free, len(self.sd))))


NO_SCATTER = RunToRun(np.zeros(3), np.zeros((3, 2)))


def run_of(name: str) -> str:
    """The run that a record is of: pieces of one log are one run."""
    return name.rpartition(" [")[0] if name.endswith("]") and " [" in name else name


def varied(model: Model, own: np.ndarray) -> Model:
    """A model with a run's own deviations (3), as far as the bounds of its parameters allow."""
    if not np.any(own):
        return model

    def scaled(key: str, share: float) -> float:
        parameter = model.parameter(key)
        return float(np.clip(model.number(key) * (1.0 + share), parameter.lower, parameter.upper))

    values = {"linear.gain_deg_s_per_pct": scaled("linear.gain_deg_s_per_pct", float(own[GAIN]))}
    values |= {key: scaled(key, float(own[FRICTION])) for key in FRICTIONS if key in model.values}
    changed = model.with_values(values)
    if not own[LOAD]:
        return changed
    key = f"{LOAD_EFFECT}.level_pct"
    if LOAD_EFFECT not in changed.effects:
        changed = changed.with_effect(LOAD_EFFECT, {"level_pct": 0.0})
    bounds = changed.parameter(key)
    return changed.with_values({key: float(np.clip(changed.number(key) + own[LOAD], bounds.lower, bounds.upper))})


def growth(own: np.ndarray) -> np.ndarray:
    """By how much a run's own values (3) multiply a derivative (3) by further ones: those of gain and dry friction are
    shares of the mean, so that they add while the model multiplies.
    """
    return np.asarray(np.maximum((1.0 + own[GAIN], 1.0 + own[FRICTION], 1.0), LEAST_GROWTH))


def shifted(p: np.ndarray, on: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parameter array and switches of the kernel, as ``varied`` has them of a model."""
    p, on = p.copy(), on.copy()
    p[_GAIN] *= max(1.0 + own[GAIN], LEAST_GROWTH)
    p[_FRICTIONS] *= max(1.0 + own[FRICTION], 0.0)
    p[_LOAD] += own[LOAD]
    on[EFFECT_INDEX[LOAD_EFFECT]] = True
    return p, on


class _Mean(NamedTuple):
    """The runs' mean for each of some looks at how they scatter: how well it is known (``values``, looks by 3; one
    where it is not ``seen``) along ``vectors`` (looks, 3, 3), how it is pulled ``along`` them (looks, 3), and the
    ``deviance`` (looks) of the scatter about it.
    """

    values: np.ndarray
    vectors: np.ndarray
    seen: np.ndarray
    along: np.ndarray
    deviance: np.ndarray


def _mean_of(pulls: Sequence[Pull], sds: np.ndarray) -> _Mean:
    """The runs' mean under scatters (looks, 3): generalised least squares, and -2 log restricted likelihood, the mean
    free, but for a constant.
    """
    information = np.array([pull.information for pull in pulls])  # (runs, 3, 3)
    score = np.array([pull.score for pull in pulls])[:, :, None]
    rows, columns = sds[:, None, :, None], sds[:, None, None, :]
    inner = np.eye(3) + rows * information * columns
    scaled = rows * score
    inverse = np.linalg.inv(inner)
    taken = information * columns @ inverse
    known = np.sum(information - taken @ (rows * information), axis=1)
    pulled = np.sum(score - taken @ scaled, axis=1)
    values, vectors = np.linalg.eigh(known)
    seen = values > 1e-9 * np.maximum(values.max(axis=1, keepdims=True), 1e-300)
    along = (np.swapaxes(vectors, 1, 2) @ pulled)[:, :, 0]
    values = np.where(seen, values, 1.0)
    explained = np.sum(scaled * (inverse @ scaled), axis=(1, 2, 3)) + np.sum(
        np.where(seen, along**2 / values, 0.0), axis=1
    )
    deviance = np.linalg.slogdet(inner)[1].sum(axis=1) + np.log(values).sum(axis=1) - explained
    return _Mean(values, vectors, seen, along, np.asarray(deviance))


def _deviances(pulls: Sequence[Pull], sds: np.ndarray) -> np.ndarray:
    return _mean_of(pulls, sds).deviance


def _common_load(pulls: Sequence[Pull], sd: np.ndarray) -> tuple[float, float]:
    """The runs' mean load under a scatter (3), over its standard error, and that; nil where the load does not
    scatter.
    """
    if sd[LOAD] <= 0.0:
        return 0.0, 0.0
    mean = _mean_of(pulls, sd[None])
    by_load = np.where(mean.seen[0], mean.vectors[0, LOAD], 0.0)
    error = float(np.sqrt(by_load**2 @ (1.0 / mean.values[0])))
    return (float(by_load @ (mean.along[0] / mean.values[0])) / error if error > 0.0 else 0.0), error


def estimate_runs(pulls: dict[str, Pull], settings: NoiseSettings = SETTINGS) -> RunToRun:
    """Scatter over runs from how they pull; none of fewer than three runs, of a model that runs away in one, or where
    chance would do.
    """
    parts = list(pulls.values())
    finite = all(np.isfinite(pull.information).all() and np.isfinite(pull.score).all() for pull in parts)
    if len(pulls) < settings.least_runs or not finite:
        return NO_SCATTER
    grids = [np.concatenate(([0.0], np.geomspace(low, high, settings.run_looks))) for low, high in settings.run_spans]
    # What moves runs alike can stand for each other, so that one after the other may end beside the best of all three.
    few = [grid[:: settings.run_coarse] for grid in grids]
    looks = np.stack(np.meshgrid(*few, indexing="ij"), axis=-1).reshape(-1, 3)
    sd = looks[int(np.argmin(_deviances(parts, looks)))]

    def profile(k: int) -> np.ndarray:
        return _deviances(parts, np.where(np.arange(3) == k, grids[k][:, None], sd))

    for _ in range(settings.run_sweeps):
        for k in range(3):
            sd = np.where(np.arange(3) == k, grids[k][int(np.argmin(profile(k)))], sd)
    order = np.argsort(_deviances(parts, np.where(np.eye(3) > 0.0, 0.0, sd)))
    for k in order.tolist():
        less = np.where(np.arange(3) == k, 0.0, sd)
        without, with_it = _deviances(parts, np.array([less, sd]))
        if without - with_it < settings.run_deviance:
            sd = less
    if not sd.any():
        return NO_SCATTER
    ci95 = np.zeros((3, 2))
    for k in np.flatnonzero(sd).tolist():
        deviances = profile(k)
        inside = grids[k][deviances <= deviances.min() + settings.interval_deviance]
        ci95[k] = inside[0], inside[-1]
    own = {name: likeliest(pull, sd) for name, pull in pulls.items()}
    return RunToRun(sd, ci95, own, *_common_load(parts, sd))


def likeliest(pull: Pull, sd: np.ndarray) -> np.ndarray:
    """What is a run's own (3), most likely: the best linear prediction by scatters ``sd`` (3)."""
    inner = np.eye(3) + sd[:, None] * pull.information * sd
    return np.asarray(sd * np.linalg.solve(inner, sd * pull.score))


def each_alone(pulls: dict[str, Pull], settings: NoiseSettings = SETTINGS) -> RunToRun:
    """What differs between runs as each says alone, nothing shrunk: so the rest of the noise is free of it."""
    most, own = [high for _, high in settings.run_spans], {}
    for name, pull in pulls.items():
        scale = np.sqrt(np.maximum(np.diag(pull.information), 1e-300))
        found = np.linalg.lstsq(pull.information / np.outer(scale, scale), pull.score / scale, rcond=1e-6)[0] / scale
        own[name] = np.clip(found, np.negative(most), most)
    return RunToRun(np.zeros(3), np.zeros((3, 2)), own)


def centred(runs: RunToRun, pulls: dict[str, Pull]) -> tuple[RunToRun, np.ndarray]:
    """What differs between runs about a mean of its own (3), which is the model's: of gain and dry friction, each run
    weighing by what it says of them. A fit would hardly move along it: only how runs scatter speaks for it.
    """
    mean = np.zeros(3)
    for k in (GAIN, FRICTION):
        known = np.array([pulls[name].information[k, k] for name in runs.by_run])
        weights = known / (1.0 + runs.sd[k] ** 2 * known)
        values = np.array([own[k] for own in runs.by_run.values()])
        mean[k] = float(weights @ values) / max(float(weights.sum()), 1e-300)
    own = {name: (values - mean) / (1.0 + mean) for name, values in runs.by_run.items()}
    return replace(runs, by_run=own), mean


@dataclass(frozen=True)
class Own:
    """What is a run's own in the windows of one of its records: ``values`` (3), whitened derivatives by them
    (``columns``, n by 3), and what weighs for how they scatter: directions (n, k), how much (k) of each is taken out,
    and the logarithm of the covariance's determinant.

    The model is linear in them around their most likely values (Lindstrom and Bates 1990).
    """

    values: np.ndarray
    columns: np.ndarray = field(repr=False)
    along: np.ndarray = field(repr=False)
    taken: np.ndarray = field(repr=False)
    log_determinant: float

    @classmethod
    def of(cls, values: np.ndarray, columns: np.ndarray, sd: np.ndarray) -> Own:
        left, sizes, _ = np.linalg.svd(columns * sd, full_matrices=False)
        return cls(values, columns, left, 1.0 - 1.0 / np.sqrt(1.0 + sizes**2), float(np.log1p(sizes**2).sum()))

    @classmethod
    def alone(cls, values: np.ndarray, samples: int) -> Own:
        """Values as they are, of a scatter that is not known."""
        return cls(values, np.zeros((samples, 3)), np.empty((samples, 0)), np.empty(0), 0.0)

    def weighed(self, white: np.ndarray) -> np.ndarray:
        """A whitened series (n) or several (n, k), weighed."""
        taken = self.taken if white.ndim == 1 else self.taken[:, None]
        return np.asarray(white - self.along @ (taken * (self.along.T @ white)))

    def back(self) -> np.ndarray:
        """What a run's own values changed (n), weighed: with it residuals are those of the runs' mean."""
        return self.weighed(self.columns @ self.values)
