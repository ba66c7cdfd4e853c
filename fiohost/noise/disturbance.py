"""The noise of one record: what its bootstrap samples are drawn with, and what whitens its windows."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from fiohost.noise.estimate import Noise
from fiohost.noise.runs import Own
from fiohost.noise.whiten import Whitener


@dataclass(frozen=True)
class Disturbance:
    """Noise as estimated, the whitener of a record's windows by it (None: bootstrap samples only), and what is its
    run's ``own``.
    """

    noise: Noise
    whitener: Whitener | None = field(default=None, repr=False)
    own: Own | None = field(default=None, repr=False)

    def whitened(self, series: np.ndarray) -> np.ndarray:
        """A series (k) or several (k, c) over the samples of the record's windows, whitened."""
        if self.whitener is None:
            return series
        white = self.whitener.apply(series)
        return white if self.own is None else self.own.weighed(white)

    def residuals(self, series: np.ndarray) -> np.ndarray:
        """What the model with a run's own values leaves (k), whitened, as the runs' mean would leave it."""
        white = self.whitened(series)
        return white if self.own is None else white + self.own.back()

    @property
    def log_determinant(self) -> float:
        whitener = self.whitener.log_determinant if self.whitener else 0.0
        return whitener + (self.own.log_determinant if self.own else 0.0)
