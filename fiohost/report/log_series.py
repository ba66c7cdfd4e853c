"""A log as series to draw: output, speed, duty and what was measured beside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.signal import detrend, savgol_filter, welch

from fiohost.bench.head import OUTPUT_UNITS
from fiohost.bench.log import Log
from fiohost.report.series import Array

SMOOTHED_S = 0.05  # over which a speed is taken from an angle, at least 5 ticks
KNOWN = ("time_s", "duty_pct", "c3", "c4", "pos", "direction", "host_time_s", "ref_deg", *OUTPUT_UNITS)
QUANTITIES = {"deg": "angle", "deg/s": "speed", "m": "position", "m/s": "speed"}
SEGMENTS = 8  # over which a spectrum is averaged


@dataclass(frozen=True)
class LogSeries:
    """One log, arrays (rows,): ``speed`` in ``speed_unit`` is measured, or taken from an angle; ``beside`` maps a
    column's name to its values; ``simulated`` is the output of a model on the same commands, and ``model`` its name.
    """

    name: str
    unit: str
    time_s: Array
    output: Array
    speed: Array | None
    speed_unit: str
    duty_pct: Array
    sample_time_s: float
    ref: Array | None = None
    beside: Mapping[str, Array] = field(default_factory=dict)
    simulated: Array | None = None
    model: str = ""

    @property
    def quantity(self) -> str:
        return QUANTITIES[self.unit]

    @property
    def error_rms(self) -> float | None:
        """Of the simulated output, in ``unit``."""
        return None if self.simulated is None else float(np.sqrt(np.mean((self.output - self.simulated) ** 2)))


def series_of(log: Log, name: str | None = None, simulated: Array | None = None, model: str = "") -> LogSeries:
    """The series of a log."""
    unit = log.output_unit
    measured = unit in ("deg/s", "m/s")
    speed = None if measured or len(log) < 5 else speed_of(log.time_s, log.output, log.sample_time_s)
    ref = log.columns.get("ref_deg")
    beside = {k: v for k, v in log.columns.items() if k not in KNOWN and "_" in k and np.isfinite(v).any()}
    return LogSeries(
        name or log.path.name, unit, log.time_s, log.output, speed, f"{unit}/s", log.duty_pct, log.sample_time_s,
        ref if ref is not None and unit == "deg" and np.isfinite(ref).any() else None, beside, simulated, model,
    )  # fmt: skip


def speed_of(time_s: Array, output: Array, sample_time_s: float) -> Array:
    """Speed from an angle or position, shape (rows,): the slope of a parabola over SMOOTHED_S, tick by tick."""
    ticks = max(5, 2 * round(SMOOTHED_S / sample_time_s / 2) + 1)
    even = np.arange(time_s[0], time_s[-1] + 0.5 * sample_time_s, sample_time_s)
    if even.size < ticks or even.size > 20 * time_s.size:
        return np.gradient(output, time_s)
    slope = savgol_filter(np.interp(even, time_s, output), ticks, 2, deriv=1, delta=sample_time_s)
    return np.interp(time_s, even, slope)


def spectrum_of(series: LogSeries, values: Array, slope: bool = False) -> tuple[Array, Array]:
    """Frequencies (Hz) and amplitude density (unit per root Hz) of values without their trend (Welch's method).

    *slope*: of their slope, which is 2 pi f times as large.
    """
    even = np.arange(series.time_s[0], series.time_s[-1], series.sample_time_s)
    sampled = detrend(np.interp(even, series.time_s, values))
    length = max(8, min(len(even), 2 ** int(np.log2(max(8, 2 * len(even) // (SEGMENTS + 1))))))
    frequencies, power = welch(sampled, fs=1.0 / series.sample_time_s, nperseg=length)
    density = np.sqrt(power[1:])
    return frequencies[1:], 2.0 * np.pi * frequencies[1:] * density if slope else density
