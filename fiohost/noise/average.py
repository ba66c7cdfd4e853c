"""An average that forgets, through which a logger smoothed speeds that it counted: found in the readings, and undone
where noise is looked at. Counts pass it too: what they err by has its memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from fiohost.noise.settings import SETTINGS, NoiseSettings

# What a change of the command does is over after so many rows.
HELD = 10


@dataclass(frozen=True)
class Average:
    """``reading = keeps * reading before + (1 - keeps) * counted speed``, the speed in steps of ``quantum``."""

    keeps: float
    quantum: float

    @property
    def rms(self) -> float:
        """Of what counts make of a reading: each errs evenly within a count, and what one speed lacks the next has."""
        smoothed = (1.0 - self.keeps) * float(np.sqrt(2.0 / (1.0 + self.keeps)))
        return smoothed * self.quantum / float(np.sqrt(12.0))

    def undone(self, series: np.ndarray, firsts: np.ndarray) -> np.ndarray:
        """A series (n) or several (n, c) as it was before the average, but for the samples ``firsts`` (m), where
        windows begin: those stay.
        """
        found = series.copy()
        found[1:] = (series[1:] - self.keeps * series[:-1]) / (1.0 - self.keeps)
        found[firsts] = series[firsts]
        return found

    def of_every(self, readings: int) -> Average:
        """That of every so many readings: between two of them it takes about the mean of the speeds."""
        return Average(self.keeps**readings, self.quantum / readings)

    def holds(self, y: np.ndarray, settings: NoiseSettings = SETTINGS) -> bool:
        """Whether without it readings (n) differ by multiples of its counts, as some log showed."""
        times = np.diff(y[1:] - self.keeps * y[:-1]) / ((1.0 - self.keeps) * self.quantum)
        return bool(np.quantile(np.abs(times - np.rint(times)), 0.99) <= settings.on_step)

    def of(self, speed: np.ndarray, first: float) -> np.ndarray:
        """Readings (n) of counted speeds (n), the first one being what it is."""
        rest, _ = lfilter([1.0 - self.keeps], [1.0, -self.keeps], speed[1:], zi=[self.keeps * first])
        return np.concatenate(([first], rest))


def found_average(
    y: np.ndarray, duty_pct: np.ndarray, step: float, settings: NoiseSettings = SETTINGS
) -> Average | None:
    """The average of readings (n) of a speed under a command (n), printed in steps of ``step`` (0: nobody knows); None
    where there is none.

    Where the same is counted twice, a reading changes by ``keeps`` times what it did before: a ratio that is there
    again and again. Without the average all speeds then differ by multiples of one step, which no other ratio does.
    A motor of one lag is an average too, of its commands: what differs where these do says nothing, but for commands
    that always change.
    """
    changes, same = np.diff(y), np.diff(duty_pct) == 0.0
    held = np.convolve(same, np.ones(HELD), mode="valid") == HELD
    # Of each three readings in a row, where the command has long been what it is.
    where = np.concatenate((np.zeros(HELD - 2, dtype=bool), held))
    where = where if 2 * np.count_nonzero(same) > len(same) else np.ones(len(where), dtype=bool)
    before, after = changes[:-1], changes[1:]
    step = max(step, 1e-7 * float(np.max(np.abs(y), initial=0.0)), 1e-300)
    told = np.abs(before) > step / settings.on_step
    before, after, some = before[told], after[told], settings.least_ratios
    if len(before) < 2 * some:
        return None
    ratios = np.sort(after / before)
    widths = ratios[some - 1 :] - ratios[: len(ratios) - some + 1]
    for _ in range(settings.likely_ratios):
        first = int(np.argmin(widths))
        keeps = float(np.median(ratios[first : first + some]))
        found = _counted(y, where, _refined(keeps, before, after, step, settings), settings)
        if found:
            return found
        widths[max(first - some, 0) : first + some] = np.inf
    return None


def _refined(
    keeps: float, before: np.ndarray, after: np.ndarray, step: float, settings: NoiseSettings
) -> tuple[float, float]:
    """A ratio by least squares over the changes (n each) that are alike, and within how much they are: up to where the
    next one is off by far more, as nobody says to how many digits readings are printed.
    """
    off = np.abs(after - keeps * before)
    sizes = np.maximum(np.sort(off), step)[settings.least_ratios - 1 :]
    near = float(sizes[int(np.argmax(sizes[1:] / sizes[:-1]))])
    alike = off <= near
    return float(after[alike] @ before[alike]) / float(before[alike] @ before[alike]), near


def _counted(y: np.ndarray, where: np.ndarray, ratio: tuple[float, float], settings: NoiseSettings) -> Average | None:
    """The average of a ratio, if without it all speeds, ``where`` it counts, differ by multiples of one step."""
    keeps, near = ratio
    if not settings.on_step < keeps < 1.0 - settings.on_step**2:
        return None
    speed = (y[1:] - keeps * y[:-1]) / (1.0 - keeps)
    moves = np.abs(np.diff(speed))[where]
    moves = moves[moves > 2.0 * near / (1.0 - keeps)]
    if len(moves) < settings.least_ratios:
        return None
    quantum = float(np.median(moves[moves < 1.5 * float(moves.min())]))
    times = np.rint(moves / quantum)
    if float(np.quantile(np.abs(moves / quantum - times), 0.99)) > settings.on_step:
        return None
    return Average(float(f"{keeps:.4g}"), float(f"{moves.sum() / times.sum():.4g}"))
