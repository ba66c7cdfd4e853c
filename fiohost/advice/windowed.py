"""Series as one-second windows show them: without what a window's own initial angle and speed take."""

from __future__ import annotations

import numpy as np

from fiohost.estimation.record import ANGLE, Record


class Windowed:
    """The windows of a record under a linear model of lag ``lag_s``: angle and speed are free in each."""

    def __init__(self, record: Record, lag_s: float) -> None:
        times = record.excitation.times_s
        self.edges = record.windows
        self._bases = []
        for a, b in zip(self.edges[:-1], self.edges[1:], strict=True):
            decay = np.exp(-(times[a:b] - times[a]) / lag_s)
            free = np.column_stack((np.ones(b - a), 1.0 - decay)) if record.kind == ANGLE else decay[:, None]
            self._bases.append(np.linalg.qr(free)[0])

    def clean(self, series: np.ndarray) -> np.ndarray:
        """A series (n) or several (n, k) without what the windows' initial states would take."""
        out = np.empty_like(series)
        for a, b, basis in zip(self.edges[:-1], self.edges[1:], self._bases, strict=True):
            out[a:b] = series[a:b] - basis @ (basis.T @ series[a:b])
        return out
