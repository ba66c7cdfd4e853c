"""Mean speeds that were taken from counts, summed up to the counts that they were taken from.

What one such speed lacks the next one has. Weighed each by itself they say little of what is slow and small; their sum
is the sensor's own reading, an angle within one count for as long as the log is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from fiohost.estimation.fit import fit_from_scratch
from fiohost.estimation.record import ANGLE, MEAN_SPEED, REST_SAMPLES, Record, rest_weights
from fiohost.motor.model import Model
from fiohost.noise.quantum import found_quantum


@dataclass(frozen=True)
class CountSettings:
    """Numbers by which mean speeds are taken for differences of counts."""

    # How readings err is looked at in blocks of so many, a curve of this degree taken off: what a motor does slowly is
    # no error. 23 of 24 drawn benches are recognised every 5 ms, 21 every 20 ms.
    block: int = 16
    curve: int = 2
    # No block says more than this, as a logarithm of odds: one with a kink in it is no noise of either kind.
    most: float = 3.0
    # A reading is a whole number of counts to this share of one, and of no more than so many.
    whole: float = 0.2
    most_counts: float = 1e9


SETTINGS = CountSettings()


def as_counts(records: Sequence[Record], model: Model) -> list[Record] | None:
    """Records of the angles whose counts mean speeds of a shaft were taken from, each from zero at its first sample.

    None where one of them is of something else or lacks rows, and where what the ``model`` leaves of all of them does
    not err as counts do: a speed that was measured and then rounded adds up to nothing.
    """
    summed = [_summed_up(r) for r in records]
    counted = [r for r in summed if r is not None]
    if len(counted) < len(records):
        return None
    found = fit_from_scratch(model, records, windows=True)
    return counted if sum(map(odds_of_counts, found.errors(records))) > 0.0 else None


def _summed_up(record: Record) -> Record | None:
    """A record of whole counts as their sum; None where it has none, or has them averaged."""
    if (
        record.kind != MEAN_SPEED
        or not record.rotary
        or record.broken
        or record.average
        or record.noise_rms is not None
    ):
        return None
    ticks = np.rint(np.diff(record.excitation.times_s) / record.sample_time_s)
    least = float(np.abs(record.y).max()) / SETTINGS.most_counts
    steps = [q for q in (record.quantum, found_quantum(record.y)) if q > least]
    turns = [record.y[1:] * ticks / q for q in steps]
    off = [round(float(np.abs(t - np.rint(t)).max()), 2) for t in turns]  # what was said is said roughly at times
    if min(off, default=np.inf) > SETTINGS.whole:
        return None
    quantum, counts = steps[off.index(min(off))], np.rint(turns[off.index(min(off))])
    count = quantum * record.sample_time_s
    angle = count * np.concatenate(([0.0], np.cumsum(counts)))
    return replace(
        record,
        y=angle,
        kind=ANGLE,
        unit=record.unit.removesuffix("/s"),
        quantum=count,
        begun_deg=0.0,
        at_rest=record.at_rest and bool(np.ptp(angle[:REST_SAMPLES]) == 0.0),
        weights=rest_weights(angle, ANGLE, count, record.sample_time_s),
    )


@lru_cache(maxsize=1)
def _shapes() -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, m) outside a curve through so many readings in which differences of white errors are apart, and
    their variances (m) for errors of one.
    """
    n, terms = SETTINGS.block, SETTINGS.curve + 1
    curve = np.vander(np.linspace(-1.0, 1.0, n), terms)
    free = np.linalg.svd(curve, full_matrices=True)[0][:, terms:]
    difference = np.diff(np.eye(n + 1), axis=0)
    values, vectors = np.linalg.eigh(free.T @ difference @ difference.T @ free)
    return free @ vectors, values


def odds_of_counts(left: np.ndarray) -> float:
    """How much speaks for what a model leaves of readings (n) to be differences of errors, as counts have them, and
    not errors of each reading by itself: the logarithm of the odds by the likelihoods of both, summed over blocks, each
    with a size of its own.
    """
    n = SETTINGS.block
    blocks = left[: len(left) // n * n].reshape(-1, n).T
    directions, variances = _shapes()
    powers = (directions.T @ blocks) ** 2
    alone, taken = powers.sum(axis=0), (powers / variances[:, None]).sum(axis=0)
    known = taken > 0.0
    odds = 0.5 * (len(variances) * np.log(alone[known] / taken[known]) - float(np.log(variances).sum()))
    return float(np.clip(odds, -SETTINGS.most, SETTINGS.most).sum())
