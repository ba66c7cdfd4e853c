"""A log's figures with the signature of an effect added to what a model leaves of it, at any size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fiohost.advice.windowed import Windowed
from fiohost.discover.settings import SETTINGS as SEARCH
from fiohost.estimation.record import ANGLE, Record
from fiohost.judging.metrics import Judgement, spans

# A factor on a signature is looked for between these: at so close ones where figures are polynomials of it, else
# downwards in strides until it is known as precisely.
FACTORS, PRECISELY, STRIDE = (1e-4, 1e4), 1.03, 2.0
GRID = np.geomspace(*FACTORS, 1 + round(np.log(FACTORS[1] / FACTORS[0]) / np.log(PRECISELY)))


class Seen(NamedTuple):
    """The smallest factor on a signature at which it is seen, infinite where none is, by which figure of which log."""

    factor: float = np.inf
    log: str = ""
    figure: str = ""


class Log:
    """One record's residuals and the bounds of its figures, to which a signature (n) is added."""

    def __init__(self, record: Record, judgement: Judgement, bounds: dict[str, float], lag_s: float) -> None:
        self.record, self.bounds = record, {figure: bound for figure, bound in bounds.items() if bound > 0.0}
        self.free, self.windows = judgement.free_residual, judgement.window_residual
        self.first = record.first_second()
        self.windowed = Windowed(record, lag_s)
        self.weights = record.weights**2 / float(record.weights @ record.weights)
        self.alike = np.full(len(record), 1.0 / len(record))

    def grown(self, signature: np.ndarray) -> Grown:
        """A signature as it shows in the free run, begun with the first second, and in windows."""
        free = signature - signature[: self.first].mean() if self.record.kind == ANGLE else signature
        return Grown(self, free, self.windowed.clean(free))


class Grown:
    """The figures of a log over their bounds with a signature (n in the free run, n in windows) added.

    Those that are squares are polynomials of the factor on it; samples and windows are counted.
    """

    def __init__(self, log: Log, free: np.ndarray, windows: np.ndarray) -> None:
        self.log, self.free, self.windows = log, free, windows
        self.means = float(log.weights @ log.free), float(log.weights @ free)
        self.squares = _products(log.free, free, log.weights)
        self.in_windows = _products(log.windows, windows, log.alike)

    def squared(self, factor: Any) -> dict[str, Any]:
        """Root mean squares over their bounds at a factor, or at many of them at once."""
        offset, mean = self._offset(factor), self.means[0] + factor * self.means[1]
        square = _polynomial(self.squares, factor) - offset * (2.0 * mean - offset)
        return self._over(free_run_rms=np.sqrt(np.maximum(square, 0.0)),
                          window_rms=np.sqrt(np.maximum(_polynomial(self.in_windows, factor), 0.0)))  # fmt: skip

    def counted(self, factor: float) -> dict[str, Any]:
        """Shares of samples and windows over their bounds at a factor."""
        log, quantum = self.log, self.log.record.quantum
        outside = np.abs(log.free + factor * self.free - self._offset(factor)) > 0.5 * quantum
        spanned = spans(log.windows + factor * self.windows, log.record.windows[:-1])
        return self._over(
            bin_violation_pct=100.0 * float(log.weights @ outside) if quantum > 0.0 else 0.0,
            wide_windows_pct=100.0 * float(np.mean(spanned > SEARCH.floor.wide * quantum)),
        )

    def _over(self, **figures: Any) -> dict[str, Any]:
        return {name: value / self.log.bounds[name] for name, value in figures.items() if name in self.log.bounds}

    def _offset(self, factor: Any) -> Any:
        """Where within its first count the angle is, as ``weigh`` has it."""
        half = 0.5 * self.log.record.quantum if self.log.record.kind == ANGLE else 0.0
        return np.clip(self.means[0] + factor * self.means[1], -half, half)

    def by_squares(self) -> Seen:
        """Where a figure that is a square passes its bound."""
        seen = Seen()
        for figure, over in self.squared(GRID).items():
            beyond = over > 1.0
            if beyond.any():
                seen = min(seen, Seen(float(GRID[np.argmax(beyond)]), self.log.record.name, figure))
        return seen

    def by_counts(self, below: float) -> Seen:
        """Where a figure that is counted passes its bound, ``below`` a factor."""

        def passed(factor: float) -> bool:
            return any(over > 1.0 for over in self.counted(factor).values())

        low = high = min(below, FACTORS[1])
        if not passed(high):
            return Seen()
        while low > FACTORS[0] and passed(low):
            low, high = low / STRIDE, low
        while high > low * PRECISELY:
            middle = float(np.sqrt(low * high))
            low, high = (low, middle) if passed(middle) else (middle, high)
        figures = self.counted(high)
        return Seen(high, self.log.record.name, max(figures, key=lambda name: figures[name]))


def smallest(grown: Sequence[Grown]) -> Seen:
    """The smallest factor on a signature at which it is seen in any of several logs."""
    seen = min((g.by_squares() for g in grown), default=Seen())
    for g in grown:
        seen = min(seen, g.by_counts(seen.factor))
    return seen


def largest(grown: Sequence[Grown]) -> tuple[float, str, str]:
    """The largest figure of a signature over its bound, its log and its name."""
    figures = [(g.log.record.name, {**g.squared(1.0), **g.counted(1.0)}) for g in grown]
    return max((float(over), log, figure) for log, found in figures for figure, over in found.items())


def _polynomial(coefficients: np.ndarray, factor: Any) -> Any:
    return coefficients[0] + factor * (coefficients[1] + factor * coefficients[2])


def _products(base: np.ndarray, added: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The weighted sum of squares of ``base`` (n) with a factor times another (n) added: its polynomial (3)."""
    weighed = weights * added
    return np.array([weights @ base**2, 2.0 * (weighed @ base), weighed @ added])
