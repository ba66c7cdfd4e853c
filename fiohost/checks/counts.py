"""A record as counts on ticks, and what no shaft can do between two of them.

A shaft's speed changes by a bounded amount in one sample, and a count is wrong by less than one. So of three successive
readings or increments the middle one lies between what its neighbours on either side foretell, give or take two counts
and the change of speed that the record itself shows to be in reach. What lies outside did not happen to the shaft.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.estimation.record import ANGLE, FOURTH_DIFFERENCE, TO_SIGMA, Record

# A second difference of readings that are each wrong by less than a count is wrong by less than two.
COUNTS_OF_DOUBT = 2.0
# Speed in counts a sample above which a reading cannot repeat by the counts' coarseness.
AT_SPEED = 4.0
# The change of speed in reach is read off over this many samples, and trusted with this factor.
SPAN, REACH, FEW = 4, 1.5, 0.003
# Standard deviation of a count in counts; an analogue sensor's noise is what its readings show beyond it.
COUNT_NOISE = 1.0 / np.sqrt(12.0)
NOISE_SIGMAS = 5.0
# At a steady speed of so many counts and a half a sample the counts' errors alternate by a quarter, the roughest that
# counts alone can be; a fourth difference makes sixteen of one.
ROUGHEST_COUNTS = 1.2 * TO_SIGMA * 0.25 * 16.0 / FOURTH_DIFFERENCE
LEAST_MOVING = 50
MOST_REPEATS = 3


@dataclass(frozen=True)
class Counts:
    """``counts`` (n) of a record, of speeds their sum; ``ticks`` (n - 1) from row to row as the stamps say and
    ``whole`` (n - 1) as they must have been; ``quantum`` in the record's unit.
    """

    counts: np.ndarray
    ticks: np.ndarray
    whole: np.ndarray
    quantum: float

    @property
    def steps(self) -> np.ndarray:
        """Counts (n - 1) from row to row."""
        return np.diff(self.counts)

    @property
    def regular(self) -> np.ndarray:
        """Whether (n - 1) a row follows the one before by one tick."""
        return np.asarray(self.whole == 1)

    def speed(self, half: int = 3) -> np.ndarray:
        """Counts a tick (n - 1): the median over ``2 half + 1`` steps around each, which no single fault moves."""
        steps = self.steps / self.whole
        padded = np.pad(steps, half, mode="edge")
        return np.asarray(np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1))


def quantum_of(record: Record) -> float:
    """The sensor's step: the record's, else the smallest difference of its readings; 0 where they are all equal."""
    if record.quantum > 0:
        return record.quantum
    steps = np.diff(np.unique(record.y))
    return float(np.min(steps)) if steps.size else 0.0


def counts_of(record: Record) -> Counts | None:
    """The record in counts; None where nothing ever changes."""
    quantum = quantum_of(record)
    if quantum <= 0 or len(record) < 2 * SPAN + 2:
        return None
    scaled = record.y / quantum
    time = record.excitation.times_s / record.sample_time_s
    # A late stamp is no missing tick, and neither is a clock that is a little fast: both ways of counting must say so.
    whole = np.minimum(np.rint(np.diff(time)), np.diff(np.rint(time)))
    counts = scaled if record.kind == ANGLE else np.cumsum(scaled)
    return Counts(counts, np.diff(time), np.maximum(whole, 1.0), quantum)


def _same_side(*parts: np.ndarray) -> np.ndarray:
    """The part of least size where all parts have one sign, else 0."""
    stack = np.array(parts)
    one_sign = np.all(stack > 0, axis=0) | np.all(stack < 0, axis=0)
    return np.asarray(np.where(one_sign, np.sign(stack[0]) * np.min(np.abs(stack), axis=0), 0.0))


def _large(values: np.ndarray) -> float:
    """Nearly the largest value: what a few faults have made is left out."""
    rank = 1 + int(FEW * len(values))
    return float(np.sort(values)[-rank]) if len(values) >= rank else 0.0


def reach(data: Counts) -> float:
    """Change of speed in counts a sample that the record shows to happen, from what lasts longer than one sample."""
    change = np.diff(data.steps)
    whole = data.regular[1:] & data.regular[:-1]
    lasting = np.abs(_same_side(change[1:], change[:-1]))[whole[1:] & whole[:-1]]
    c = data.counts
    wide = np.abs(c[2 * SPAN :] - 2 * c[SPAN:-SPAN] + c[: -2 * SPAN]) / SPAN**2
    unbroken = np.convolve(data.regular, np.ones(2 * SPAN), mode="valid") == 2 * SPAN
    return REACH * max(_large(lasting), _large(wide[unbroken]))


def roughness(data: Counts) -> tuple[np.ndarray, np.ndarray]:
    """Fourth differences (m) of unbroken readings scaled to the noise of one, and the speed (m) at each."""
    d4 = np.diff(data.counts, n=4) / FOURTH_DIFFERENCE
    unbroken = np.convolve(data.regular, np.ones(4), mode="valid") == 4
    return d4[unbroken], data.speed()[1:-2][unbroken]


def spread(values: np.ndarray) -> float:
    """Standard deviation of the bulk, from the median of sizes."""
    return TO_SIGMA * float(np.median(np.abs(values))) if values.size else 0.0


def noisy_sensor(records: Sequence[Record]) -> bool:
    """Whether readings of a moving shaft are rougher than any counts make them; of a sensor without counts nothing else
    is known.
    """
    if max(r.quantum for r in records) <= 0.0:
        return True
    found = [roughness(data) for data in map(counts_of, records) if data is not None]
    rough = np.concatenate([[], *(r[np.abs(speed) > AT_SPEED] for r, speed in found)])
    return len(rough) >= LEAST_MOVING and spread(rough) > ROUGHEST_COUNTS


def doubt(data: Counts) -> float:
    """How far, in counts, a reading may stand outside what its neighbours foretell."""
    rough, speed = roughness(data)
    moving = np.abs(speed) > AT_SPEED
    noise = spread(rough[moving]) if np.sum(moving) >= LEAST_MOVING else 0.0
    return COUNTS_OF_DOUBT + reach(data) + (NOISE_SIGMAS * noise if noise > ROUGHEST_COUNTS else 0.0)


def jumps(data: Counts) -> np.ndarray:
    """By how much (n - 1) each step stands outside both its neighbours and stays there; 0 where it does not."""
    found = np.zeros(len(data.counts) - 1)
    steps, regular = data.steps, data.regular
    outside = _same_side(steps[1:-1] - steps[:-2], steps[1:-1] - steps[2:])
    whole = regular[1:-1] & regular[:-2] & regular[2:]
    found[1:-1] = np.where(whole & (np.abs(outside) > doubt(data)), outside, 0.0)
    # What stays is still there some samples on, beside what the speed around it accounts for.
    padded = np.pad(steps - data.speed(), 2, mode="edge")
    stays = np.convolve(padded, np.ones(5), mode="valid")
    return np.where(np.abs(stays - found) < 0.5 * np.abs(found), found, 0.0)


def spikes(data: Counts) -> np.ndarray:
    """By how much (n) each reading stands outside what both sides foretell; 0 where it does not."""
    found = np.zeros(len(data.counts))
    bend = np.diff(data.counts, n=2)
    outside = _same_side(bend[:-2], bend[2:], -0.5 * bend[1:-1])
    whole = np.convolve(data.regular, np.ones(4), mode="valid") == 4
    found[2:-2] = np.where(whole & (np.abs(outside) > doubt(data)), outside, 0.0)
    return found


def repeats(data: Counts) -> tuple[np.ndarray, int]:
    """Steps (n - 1, boolean) of exactly nothing, few between many that go on, and how many steps were at speed."""
    steps, speed = data.steps, data.speed()
    at_speed = (np.abs(speed) > max(AT_SPEED, COUNTS_OF_DOUBT + reach(data))) & data.regular
    index = np.arange(len(steps))
    before = np.maximum.accumulate(np.where(steps != 0, index, -1))
    after = np.minimum.accumulate(np.where(steps != 0, index, len(steps))[::-1])[::-1]
    inside = (before >= 0) & (after < len(steps)) & (after - before <= MOST_REPEATS + 1)
    way = np.sign(speed)
    last, coming = way * steps[np.maximum(before, 0)], way * steps[np.minimum(after, len(steps) - 1)]
    # A step too far before it is a spike that a step of nothing takes back.
    goes_on = inside & (last > 0) & (coming > 0) & (last <= np.abs(speed) + COUNTS_OF_DOUBT + reach(data))
    return (steps == 0) & goes_on & at_speed, int(np.sum(at_speed))
