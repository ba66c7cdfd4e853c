"""The step of a sensor, found in its readings where nobody says it."""

from __future__ import annotations

import numpy as np

from fiohost.noise.settings import SETTINGS, NoiseSettings


def found_quantum(y: np.ndarray, settings: NoiseSettings = SETTINGS) -> float:
    """The step of which all differences of readings (n) are multiples, 0 where there is none.

    Readings printed with few digits differ from multiples by their rounding; the smallest difference of an analogue
    sensor's is none that the others are multiples of.
    """
    values = np.unique(y)
    steps = np.diff(values)
    if len(steps) < settings.least_steps:
        return 0.0
    real = steps[steps > 1e-6 * float(steps.max())]  # the rest is rounding in the last digits
    smallest = float(np.median(real[real < 1.5 * float(real.min())]))
    times = np.rint(real / smallest)
    if float(np.quantile(np.abs(real / smallest - times), 0.99)) > settings.on_step:
        return 0.0
    return float(real.sum() / times.sum())
