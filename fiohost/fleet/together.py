"""What the motors of a type have in common: random effects over motors, and which stand apart from the others.

Parameters are taken as they are, in units of their medians: their errors are those of least squares, which for one that
is known badly are far from those of a logarithm. The population's mean and covariance are the maximum of the
marginal likelihood, by expectation and maximisation (Laird and Ware 1982). A motor of which little was seen borrows
what it does not know of itself (empirical Bayes; Efron and Morris 1975).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

ROUNDS = 200
SETTLED = 1e-6
# Of fewer motors no population is made.
LEAST_MOTORS = 5
# A normal distribution's standard deviation by its median absolute deviation.
MAD = 1.4826
# Robust z-score from which a motor stands apart: by chance one good motor in a thousand does, with five parameters.
APART_Z = 4.0
# The covariance of a population is held off zero by this share of its parameters.
LEAST_SD = 1e-4


@dataclass(frozen=True)
class Population:
    """Mean (k) and covariance (k, k) of the parameters ``names`` over motors, in units of ``scale`` (k)."""

    names: tuple[str, ...]
    scale: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    motors: int

    def with_prior(self, values: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A motor's own values (k) and covariance (k, k; nan where it does not know) with what the type says of it."""
        mean, cov = self.posterior(*self.inner(values, covariance))
        return mean * self.scale, cov * np.outer(self.scale, self.scale)

    def inner(self, values: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and information (k, k) in the population's own terms; none where it is not known."""
        return _inner(self.scale, values, covariance)

    def posterior(self, values: np.ndarray, information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of a motor, the population being its prior."""
        prior = np.linalg.inv(self.covariance)
        cov = np.linalg.inv(prior + information)
        return cov @ (prior @ self.mean + information @ values), cov

    def alone(self, values: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """How far each parameter (k) is from the type if all others are as in it, in standard deviations; nan where a
        motor does not know. Errors that go together, as those of gain and friction do, tell less than they seem to.
        """
        found = np.full(len(values), np.nan)
        own = covariance / np.outer(self.scale, self.scale)
        known = np.isfinite(np.diag(own)) & np.isfinite(values)
        if known.any():
            part = np.ix_(known, known)
            inverse = np.linalg.inv(self.covariance[part] + own[part])
            off = (values / self.scale - self.mean)[known]
            found[known] = inverse @ off / np.sqrt(np.diag(inverse))
        return found

    def to_json(self) -> dict[str, Any]:
        sd = np.sqrt(np.diag(self.covariance))
        return {
            name: {"median": float(m * u), "sd": float(s * u), "motors": self.motors}
            for name, m, s, u in zip(self.names, self.mean, sd, self.scale, strict=True)
        }


def _inner(scale: np.ndarray, values: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    inner, own = values / scale, covariance / np.outer(scale, scale)
    information = np.zeros_like(own)
    known = np.isfinite(np.diag(own)) & (np.diag(own) > 0.0) & np.isfinite(inner)
    if known.any():
        part = np.ix_(known, known)
        information[part] = np.linalg.pinv(own[part], hermitian=True)
    return np.where(known, inner, 0.0), information


def population(rows: Sequence[Mapping[str, Any]]) -> Population | None:
    """The population of rows (``names``, ``values``, ``covariance``) of one model; None of too few.

    A motor far from the others does not make the population wide: those beyond five robust deviations are left out.
    """
    rows = [r for r in rows if not r.get("error") and r.get("names")]
    if len(rows) < LEAST_MOTORS:
        return None
    names = tuple(rows[0]["names"])
    rows = [r for r in rows if tuple(r["names"]) == names]
    values = np.array([r["values"] for r in rows], dtype=np.float64)
    covariances = np.array([np.array(r["covariance"], dtype=np.float64) for r in rows])
    scale = np.abs(np.median(values, axis=0))
    scale[scale == 0.0] = 1.0
    pairs = [_inner(scale, v, c) for v, c in zip(values, covariances, strict=True)]
    inner = values / scale
    middle = np.median(inner, axis=0)
    wide = np.maximum(MAD * np.median(np.abs(inner - middle), axis=0), LEAST_SD)
    near = np.all(np.abs(inner - middle) <= 5.0 * np.hypot(wide, _own_sd(pairs)), axis=1)
    pairs = [p for p, ok in zip(pairs, near, strict=True) if ok]
    if len(pairs) < LEAST_MOTORS:
        return None
    floor = np.diag(np.full(len(names), LEAST_SD**2))
    mean, cov = middle.copy(), np.diag(wide**2)
    for _ in range(ROUNDS):
        prior = np.linalg.inv(cov)
        covs = np.array([np.linalg.inv(prior + information) for _, information in pairs])
        means = np.array([c @ (prior @ mean + i @ v) for c, (v, i) in zip(covs, pairs, strict=True)])
        new = means.mean(axis=0)
        off = means - new
        after = (off.T @ off + covs.sum(axis=0)) / len(pairs) + floor
        settled = np.max(np.abs(after - cov)) <= SETTLED * np.max(np.abs(cov)) and np.allclose(new, mean, rtol=SETTLED)
        mean, cov = new, after
        if settled:
            break
    return Population(names, scale, mean, cov, len(pairs))


def _own_sd(pairs: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Standard deviations (motors, k) of the motors' own estimates; infinite where one knows nothing."""
    found = []
    for _, information in pairs:
        diagonal = np.diag(np.linalg.pinv(information, hermitian=True))
        found.append(np.where(np.diag(information) > 0.0, np.sqrt(np.maximum(diagonal, 0.0)), np.inf))
    return np.array(found)


def z_scores(rows: Sequence[Mapping[str, Any]], names: Sequence[str]) -> np.ndarray:
    """Robust z-scores (rows, k + 1) of parameters by median and median absolute deviation, each motor's own interval
    added, or how far it is if all other parameters are as in the type, whichever is farther; the last is that of what
    the fit leaves. nan where a row has none.
    """
    values = np.full((len(rows), len(names) + 1), np.nan)
    own, alone = np.zeros_like(values), np.full_like(values, np.nan)
    type_ = population(rows)
    for i, row in enumerate(rows):
        if row.get("error") or tuple(row.get("names", ())) != tuple(names):
            continue
        covariance = np.array(row["covariance"], dtype=np.float64)
        values[i] = [*row["values"], row["window_rms"]]
        own[i, :-1] = np.nan_to_num(np.sqrt(np.maximum(np.diag(covariance), 0.0)), nan=np.inf)
        if type_ is not None and type_.names == tuple(names):
            alone[i, :-1] = type_.alone(values[i, :-1], covariance)
    if not np.isfinite(values).any():
        return values
    middle = np.nanmedian(values, axis=0)
    wide = np.maximum(_robust_sd(values), LEAST_SD * np.abs(middle))
    sure = np.isfinite(own).any(axis=0)
    typical = np.zeros(own.shape[1])
    typical[sure] = np.nanmedian(np.where(np.isfinite(own[:, sure]), own[:, sure], np.nan), axis=0)
    # The spread holds what an ordinary motor's interval adds; only what a motor knows less well than that is its own.
    spread = np.sqrt(wide**2 + np.maximum(own**2 - typical**2, 0.0))
    marginal = np.divide(values - middle, spread, out=np.zeros_like(values), where=spread > 0.0)
    known = np.isfinite(alone).any(axis=0)
    alone[:, known] /= np.maximum(_robust_sd(alone[:, known]), 1.0)
    return np.where(np.nan_to_num(np.abs(alone)) > np.abs(marginal), alone, marginal)


def _robust_sd(values: np.ndarray) -> np.ndarray:
    """Of the columns of values (n, k), nan left out."""
    return np.asarray(MAD * np.nanmedian(np.abs(values - np.nanmedian(values, axis=0)), axis=0))


def trend(order: np.ndarray, values: np.ndarray) -> dict[str, float] | None:
    """Theil-Sen slope of values (n) over a serial number or time (n), with Kendall's test; None of too few."""
    from scipy.stats import kendalltau, theilslopes

    ok = np.isfinite(order) & np.isfinite(values)
    if int(ok.sum()) < LEAST_MOTORS or len(np.unique(order[ok])) < LEAST_MOTORS:
        return None
    slope, _, low, high = theilslopes(values[ok], order[ok])
    return {"slope": float(slope), "low": float(low), "high": float(high),
            "p": float(kendalltau(order[ok], values[ok]).pvalue)}  # fmt: skip
