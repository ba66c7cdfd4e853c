"""Series as one-second windows show them: without what a window's own initial angle and speed take."""

from __future__ import annotations

import numpy as np

from fiohost.estimation.record import ANGLE, Record


class Windowed:
    """The windows of a record under a linear model of lag ``lag_s``: angle and speed are free in each."""

    def __init__(self, record: Record, lag_s: float) -> None:
        times, firsts, lengths = record.excitation.times_s, record.windows[:-1], np.diff(record.windows)
        self._alike = []  # windows (m) of one length (n) together: their samples (m, n), what is free in each (m, n, q)
        for length in np.unique(lengths):
            rows = firsts[lengths == length, None] + np.arange(length)
            decay = np.exp(-(times[rows] - times[rows[:, :1]]) / lag_s)
            free = np.stack((np.ones_like(decay), 1.0 - decay), axis=-1) if record.kind == ANGLE else decay[..., None]
            self._alike.append((rows, np.linalg.qr(free)[0]))

    def clean(self, series: np.ndarray) -> np.ndarray:
        """A series (n) or several (n, k) without what the windows' initial states would take."""
        out = np.empty_like(series)
        for rows, free in self._alike:
            part = series[rows].reshape(*rows.shape, -1)
            left = part - free @ (free.transpose(0, 2, 1) @ part)
            out[rows] = left.reshape(rows.shape + series.shape[1:])
        return out
