"""What the report room is handed beside the JSON: series and curves to draw, as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SeriesPlot:
    """One log, measured and simulated: all arrays of one length.

    ``before`` and ``after`` are the simulated output of the declared and of the final model, None where there is no
    such run. ``floor_rms`` is the error that is left when the model is right, in ``unit`` (NaN: unknown). ``angle`` is
    the shaft's on its turn in degrees, ``quantum`` the sensor's step (0: unknown).
    """

    title: str
    role: str  # "train", "holdout" or "confirm"
    unit: str
    time_s: Array
    measured: Array
    before: Array | None
    after: Array | None
    duty_pct: Array | None = None
    floor_rms: float = float("nan")
    angle: Array | None = None
    quantum: float = 0.0


@dataclass(frozen=True)
class CurvePlot:
    """A curve over any variable: a friction curve, a deadband sweep, a residual against the shaft angle.

    ``found`` marks the picture of an effect that was found, whose ``equation`` carries its numbers.
    """

    title: str
    x_label: str  # with its unit
    y_label: str
    x: Array
    lines: Mapping[str, Array]
    band: tuple[Array, Array] | None = None  # lower, upper
    band_label: str = "95 % interval"
    points: Mapping[str, tuple[Array, Array]] = field(default_factory=dict)  # label -> x, y
    equation: str = ""
    found: bool = False
