"""The noise of one record: what its bootstrap samples are drawn with, and what whitens its windows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fiohost.noise.estimate import Noise
from fiohost.noise.whiten import Whitener


@dataclass(frozen=True)
class Disturbance:
    """Noise as estimated, and the whitener of a record's windows by it; None: bootstrap samples only. ``own`` are the
    directions (n, k) in which runs differ and how much (k) of each is taken out, with the logarithm of the determinant.
    """

    noise: Noise
    whitener: Whitener | None = field(default=None, repr=False)
    own: tuple[np.ndarray, np.ndarray, float] | None = field(default=None, repr=False)

    def whitened(self, series: np.ndarray) -> np.ndarray:
        """A series (n) or several (n, k) over the record's windows, whitened."""
        if self.whitener is None:
            return series
        white = self.whitener.apply(series)
        if self.own is None:
            return white
        along, taken, _ = self.own
        return np.asarray(
            white - along @ (taken[:, None] * (along.T @ white))
            if white.ndim > 1
            else white - along @ (taken * (along.T @ white))
        )

    @property
    def log_determinant(self) -> float:
        whitener = self.whitener.log_determinant if self.whitener else 0.0
        return whitener + (self.own[2] if self.own else 0.0)
