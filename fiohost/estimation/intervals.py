"""Intervals that hold under coloured residuals: the sandwich estimator with gradients summed over blocks of time.

Count noise and what a model lacks are both strongly correlated in time; the textbook covariance, which takes every
sample as independent, is too small by an order of magnitude. Summing the gradient over blocks lets the data say how
much the blocks really differ (Liang and Zeger 1986; White 1980). Counts err alike in repeated motion, which blocks take
for independent; fits to replicas through the same sensor show that part (parametric bootstrap, Efron 1979), and the
wider of the two holds. Where runs differ from each other, their mean is known by their scatter: blocks are whole runs
there, with Student's distribution (Cameron and Miller 2015). Of what differs itself the scatter that was found says how
well so few runs know its mean (Student 1908): windows in which a shaft sticks hold a fit fast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from fiohost.estimation.fit import Fit
from fiohost.estimation.settings import SETTINGS
from fiohost.motor.effect import effect
from fiohost.motor.model import Model
from fiohost.noise.runs import FRICTION, FRICTIONS, GAIN, LOAD, LOAD_EFFECT, NO_SCATTER, RunToRun


@dataclass(frozen=True)
class Estimate:
    """``P`` of the diagnosis: a value with its 95 % interval and what is to be known about it."""

    value: float
    unit: str
    ci95: tuple[float, float]
    identifiable: bool
    at_bound: bool

    @property
    def half_width(self) -> float:
        return 0.5 * (self.ci95[1] - self.ci95[0])

    def to_json(self) -> dict[str, object]:
        return {
            "value": self.value,
            "unit": self.unit,
            "ci95": [self.ci95[0], self.ci95[1]],
            "identifiable": self.identifiable,
            "at_bound": self.at_bound,
        }


def sandwich(residuals: Sequence[np.ndarray], jacobians: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Covariance (k, k) of fitted parameters, and which of them (k) the data determine at all, from the residuals (n)
    of each record and the derivatives (n, k) of what was simulated.
    """
    k = jacobians[0].shape[1] if jacobians else 0
    hessian = np.zeros((k, k))
    spread = np.zeros((k, k))
    blocks = 0
    for residual, columns in zip(residuals, jacobians, strict=True):
        hessian += columns.T @ columns
        for a in range(0, len(residual), SETTINGS.block_samples):
            g = columns[a : a + SETTINGS.block_samples].T @ residual[a : a + SETTINGS.block_samples]
            spread += np.outer(g, g)
            blocks += 1
    scale = np.sqrt(np.maximum(np.diag(hessian), 0.0))
    seen = scale > 0
    cov = np.full((k, k), np.inf)
    determined = np.zeros(k, dtype=bool)
    if seen.any():
        index = np.flatnonzero(seen)
        scaled = hessian[np.ix_(index, index)] / np.outer(scale[index], scale[index])
        values, vectors = np.linalg.eigh(scaled)
        weak = values < SETTINGS.near_singular
        inverse = (vectors[:, ~weak] / values[~weak]) @ vectors[:, ~weak].T
        determined[index] = ~np.any(np.abs(vectors[:, weak]) > 0.1, axis=1) if weak.any() else True
        correction = blocks / max(blocks - len(index), 1)
        inner = spread[np.ix_(index, index)] / np.outer(scale[index], scale[index])
        cov[np.ix_(index, index)] = correction * (inverse @ inner @ inverse) / np.outer(scale[index], scale[index])
    return cov, determined


def covariance(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """The sandwich of a fit: covariance (k, k) of its free parameters, and which of them (k) are determined."""
    return sandwich(fit.residuals, fit.jacobians)


def between_runs(fit: Fit, which: Sequence[int]) -> np.ndarray:
    """Half widths (k) of 95 % intervals of ``which`` (k) parameters, the others held, from how the records, runs of one
    bench, scatter; zeros of one record.
    """
    runs, jacobians = len(fit.residuals), [c[:, which] for c in fit.jacobians]
    if runs < 2:
        return np.zeros(len(which))
    hessian = sum(columns.T @ columns for columns in jacobians)
    pulls = np.array([c.T @ r for c, r in zip(jacobians, fit.residuals, strict=True)])  # (runs, k)
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    inverse = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=SETTINGS.near_singular, hermitian=True)
    moves = (pulls / scale) @ inverse / scale
    deviation = np.sqrt(runs / (runs - 1.0) * (moves**2).sum(axis=0))
    return np.asarray(stdtrit(runs - 1, 0.975) * deviation)


def of_scatter(model: Model, runs: RunToRun) -> dict[str, float]:
    """Half widths of 95 % intervals of what itself differs from run to run: the mean of so few is known no better."""
    if not runs.known:
        return {}
    width = float(stdtrit(len(runs.by_run) - 1, 0.975)) / np.sqrt(len(runs.by_run)) * runs.sd
    shares = {"linear.gain_deg_s_per_pct": width[GAIN], **dict.fromkeys(FRICTIONS, width[FRICTION])}
    found = {name: float(share * abs(model.number(name))) for name, share in shares.items() if name in model.values}
    return {**found, f"{LOAD_EFFECT}.level_pct": float(width[LOAD])}


def estimates(
    fit: Fit, replicas: Sequence[Model] = (), count: float = 0.0, runs: RunToRun = NO_SCATTER
) -> dict[str, Estimate]:
    """Every number of the model with its interval; fixed ones have an interval of no width.

    ``replicas`` are models as fitted to replicas of the data, ``count`` is the step of the sensor of angle: where
    within the first count the zero lies, nobody knows, so places on the turn are known to half a count at best.
    ``runs`` is how these differ, where each record is a run of its own.
    """
    cov, determined = covariance(fit)
    # What was searched holds where it was found: what trades with its derivative is not as open as that says.
    kept = [i for i, name in enumerate(fit.names) if not fit.model.parameter(name).is_searched]
    if 0 < len(kept) < len(fit.names):
        cov[np.ix_(kept, kept)], determined[kept] = sandwich(fit.residuals, [c[:, kept] for c in fit.jacobians])
    apart = of_scatter(fit.model, runs)
    if runs.known and kept:
        by_name = zip([fit.names[i] for i in kept], between_runs(fit, kept).tolist(), strict=True)
        apart |= {name: max(half, apart.get(name, 0.0)) for name, half in by_name}
    found: dict[str, Estimate] = {}
    for name, value in fit.model.values.items():
        parameter = fit.model.parameter(name)
        if isinstance(value, str):
            continue
        if name not in fit.names:
            found[name] = Estimate(value, parameter.unit, (value, value), True, False)
            continue
        i = fit.names.index(name)
        half = 1.96 * float(np.sqrt(max(cov[i, i], 0.0))) if np.isfinite(cov[i, i]) else np.inf
        if len(replicas) > 1:
            off = np.array([model.number(name) for model in replicas]) - value
            if parameter.period:  # a fitted phase is told within one turn
                off = (off + 0.5 * parameter.period) % parameter.period - 0.5 * parameter.period
            half = max(half, float(stdtrit(len(off) - 1, 0.975) * np.std(off, ddof=1)))
        half = max(half, apart.get(name, 0.0)) + 0.5 * count * _turns_with_zero(fit.model, name)
        low, high = max(value - half, parameter.lower), min(value + half, parameter.upper)
        at_bound = value <= parameter.lower or value >= parameter.upper
        found[name] = Estimate(value, parameter.unit, (low, high), bool(determined[i]), at_bound)
    return found


def _turns_with_zero(model: Model, name: str) -> float:
    """By how much a parameter moves for each degree that the zero of angle moves: places and phases do."""
    of, parameter = effect(name.partition(".")[0]), model.parameter(name)
    if parameter.order is not None:
        return float(abs(parameter.order))
    if not of.angle_bound or parameter.neutral is not None or not parameter.unit.startswith("deg"):
        return 0.0
    order = next((q for q in of.parameters if q.whole), None)
    return model.number(f"{of.name}.{order.name}") if order and parameter.period is not None else 1.0
