"""Lines of the clock: frequencies at which what a model leaves swings whatever is commanded.

The periodogram of what is left over the running median around each frequency is exponential where there is no line; of
several records the sum of theirs is a gamma variable (Priestley 1981), and over a background that is estimated one of
Fisher's. A line stands above what the largest of all frequencies reaches once in a hundred times. A record whose
command repeats itself says nothing at its harmonics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter
from scipy.special import fdtri, gammaincinv

from fiohost.discover.settings import SETTINGS

LINES = SETTINGS.lines


@dataclass(frozen=True)
class Series:
    """What is left (n) of a record and its command (n), so many seconds apart, begun at ``clock_s`` on the bench."""

    left: np.ndarray
    duty_pct: np.ndarray
    step_s: float
    clock_s: float

    @property
    def seconds(self) -> float:
        return len(self.left) * self.step_s

    @property
    def by_command(self) -> Series:
        """The same as a share of the command, which a gain that swings leaves a line in."""
        rms = float(np.sqrt(np.mean(self.duty_pct**2)))
        return replace(self, left=self.left * self.duty_pct / rms) if rms > 0.0 else self


def clock_lines(parts: Sequence[Series]) -> list[float]:
    """Frequencies in Hz of lines in what is left of records and not in their commands: the strongest first of a torque,
    then those that only a gain shows.
    """
    found = _lines(parts)
    apart = LINES.same / (_by_the_clock(parts) or max(p.seconds for p in parts))
    by_gain = _lines([p.by_command for p in parts])
    return found + [line for line in by_gain if all(abs(line - other) > apart for other in found)]


def _lines(parts: Sequence[Series]) -> list[float]:
    longest = max(p.seconds for p in parts)
    nyquist = min(0.5 / p.step_s for p in parts)
    grid = np.arange(LINES.finer * LINES.periods, LINES.finer * longest * nyquist) / (LINES.finer * longest)
    if len(grid) < LINES.finer * LINES.fewest:
        return []
    total, known = np.zeros(len(grid)), 0
    for part in parts:
        over = _over_background(part.left, part.step_s, grid)
        if over is not None:
            length, repeats = part.seconds, _repeats(part)
            if repeats > 0.0:  # what follows its own command says nothing of the clock
                order = np.round(grid / repeats)
                over[(order > 0) & (np.abs(grid - order * repeats) <= LINES.same / length)] = 1.0
            total, known = total + over, known + 1
    if not known:
        return []
    least = 1.0 / float(fdtri(4 * known * LINES.around * LINES.knows, 2 * known, LINES.chance / len(grid)))
    peaks = _peaks(total, known * least)
    found: list[float] = []
    for i in peaks[np.argsort(total[peaks])[::-1]]:
        if all(abs(float(grid[i]) - other) > LINES.same / longest for other in found):
            found.append(float(grid[i]))
    return [_closer(line, parts, 1.0 / longest) for line in found[: LINES.most]]


def _repeats(part: Series) -> float:
    """The frequency in Hz at which a command repeats itself; 0 where it does not."""
    n = len(part.duty_pct)
    if n < 2 * LINES.fewest or float(np.ptp(part.duty_pct)) == 0.0:
        return 0.0
    power = np.abs(np.fft.rfft((part.duty_pct - part.duty_pct.mean()) * np.hanning(n))) ** 2
    largest = int(np.argmax(power))
    within = float(power[max(largest - 1, 0) : largest + 2].sum())
    periodic = largest >= LINES.periods and within >= LINES.periodic * float(power.sum())
    return largest / (n * part.step_s) if periodic else 0.0


def _by_the_clock(parts: Sequence[Series]) -> float:
    """The seconds of the bench's clock that records were taken within; 0 where they do not say when they began."""
    clocks = [p.clock_s for p in parts]
    return max(p.clock_s + p.seconds for p in parts) - min(clocks) if len(set(clocks)) == len(parts) else 0.0


def _closer(line_hz: float, parts: Sequence[Series], width: float) -> float:
    """A frequency as all records together have it by the bench's clock; as it is where that says nothing."""
    whole = _by_the_clock(parts)
    looks = 2 * int(np.ceil(LINES.finer * 2.0 * width * whole)) + 1
    if whole == 0.0 or looks > LINES.most_looks:
        return line_hz
    near = line_hz + np.linspace(-width, width, looks)
    summed = np.zeros(looks, dtype=complex)
    for part in parts:
        times = part.clock_s + np.arange(len(part.left)) * part.step_s
        tapered = (part.left - part.left.mean()) * np.hanning(len(part.left))
        summed += np.exp(-2j * np.pi * near[:, None] * times) @ tapered
    return float(near[int(np.argmax(np.abs(summed)))])


def _over_background(series: np.ndarray, step_s: float, grid_hz: np.ndarray) -> np.ndarray | None:
    """Periodogram of a series (n) on a grid (m) over its background, of mean 1 where there is no line; None of a series
    that stands, or is too short.
    """
    n = len(series)
    if n < 2 * LINES.fewest or float(np.ptp(series)) == 0.0:
        return None
    tapered = (series - series.mean()) * np.hanning(n)
    size = 1 << int(np.ceil(np.log2(LINES.finer * 4 * n)))
    power = np.abs(np.fft.rfft(tapered, size)) ** 2
    at = np.interp(grid_hz, np.fft.rfftfreq(size, step_s), power)
    reach = 2 * max(LINES.around * round(1.0 / (n * step_s * (grid_hz[1] - grid_hz[0]))), LINES.around) + 1
    background = median_filter(at, size=reach, mode="mirror") / gammaincinv(1.0, 0.5)
    return np.asarray(at / np.maximum(background, 1e-12 * float(at.max()) + 1e-300))


def _peaks(values: np.ndarray, least: float) -> np.ndarray:
    """Where values (n) have a local maximum of at least so much."""
    inner = values[1:-1]
    return 1 + np.flatnonzero((inner >= least) & (inner >= values[:-2]) & (inner >= values[2:]))
