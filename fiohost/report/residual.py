"""What is left of one record, from all sides: over time, its histogram, its autocorrelation, its spectrum, and
against speed and angle; and whether it is white, in words.
"""

from __future__ import annotations

from dataclasses import dataclass

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from scipy.signal import welch

from fiohost.report.plots import AFTER, BEFORE, FLOOR, GREY, STYLE, band, canvas
from fiohost.report.series import Array, SeriesPlot
from fiohost.report.words import with_unit

SIGMAS = 2.576  # of an autocorrelation by chance: 99 of 100 lie within
LAGS = 100
BINS = 40
SEGMENTS = 8
FEW_DECADES = 1.7  # of a spectrum: below it 2 and 5 of each decade are written too
MATTERS = 0.1  # a correlation below it explains less than a hundredth of the next error
LEGEND_ROOM = 0.16  # of a panel's height
NEAR = 10  # lags within which it is looked for


@dataclass(frozen=True)
class Residual:
    """Measured minus simulated of one record: ``error`` (n) in ``unit``, ``correlation`` (lags + 1), its value by
    ``chance``, ``memory_s`` in which it falls to a third.
    """

    title: str
    stage: str
    unit: str
    time_s: Array
    error: Array
    correlation: Array
    chance: float
    memory_s: float
    sample_time_s: float
    quantum: float
    speed: Array | None
    speed_unit: str
    angle: Array | None

    @property
    def rms(self) -> float:
        return float(np.sqrt(np.mean(self.error**2)))

    @property
    def strongest(self) -> float:
        """The correlation of the first lags that is largest in size."""
        near = self.correlation[1 : 1 + NEAR]
        return float(near[np.argmax(np.abs(near))])

    @property
    def white(self) -> bool:
        """Whether no correlation of the first lags is both beyond chance and large enough to matter."""
        return abs(self.strongest) <= max(self.chance, MATTERS)


def residual_of(series: SeriesPlot) -> Residual | None:
    """What the final model leaves of a record, else the declared one; None where the record is too short to say."""
    simulated = series.after if series.after is not None else series.before
    if simulated is None or len(series.time_s) < 50:
        return None
    error = series.measured - simulated
    if not np.all(np.isfinite(error)) or float(np.ptp(error)) == 0.0:
        return None
    tick = float(np.median(np.diff(series.time_s)))
    centred = error - error.mean()
    lags = min(LAGS, len(error) // 4)
    power = float(centred @ centred)
    correlation = np.array([1.0, *(float(centred[k:] @ centred[:-k]) / power for k in range(1, lags + 1))])
    below = np.flatnonzero(correlation < 1.0 / np.e)
    memory = float(below[0] if len(below) else lags) * tick
    speeds = {"deg": "deg/s", "m": "m/s", "mm": "mm/s"}
    speed = np.gradient(simulated, series.time_s) if series.unit in speeds else np.asarray(simulated)
    return Residual(
        series.title, "after" if series.after is not None else "before", series.unit, series.time_s, error, correlation,
        SIGMAS / np.sqrt(len(error)), memory, tick, series.quantum, speed, speeds.get(series.unit, series.unit),
        series.angle,
    )  # fmt: skip


def white_words(left: Residual, white: bool | None) -> list[str]:
    """Whether the residual is white, in sentences."""
    first = f"What is left on {left.title} is {with_unit(left.rms, left.unit)} rms"
    first += f"; one count of the sensor is {with_unit(left.quantum, left.unit)}." if left.quantum > 0 else "."
    strongest = (
        f"the strongest correlation within {NEAR} ticks is {left.strongest:.2f}, chance reaches {left.chance:.2f}"
    )
    if left.white:
        said = f"It is as good as white: an error says next to nothing about the ones that follow ({strongest})."
    else:
        said = (
            f"It is not white: errors resemble those that follow for {with_unit(left.memory_s, 's', 2)} ({strongest}). "
            "So there is motion, or rounding at slow motion, that the model does not have."
        )
    sentences = [first, said]
    if white is not None:
        told = "passes" if white else "does not pass"
        sentences.append(f"Over all records, weighed by their noise, the residual {told} a whiteness test at 1 %.")
    return sentences


@matplotlib.rc_context(STYLE)
def plot_residual(left: Residual) -> Figure:
    """Six panels: time, histogram, autocorrelation, spectrum, against speed, against angle."""
    figure = canvas(9.0, 8.6)
    axes = figure.subplots(3, 2)
    _over_time(axes[0, 0], left)
    _histogram(axes[0, 1], left)
    _autocorrelation(axes[1, 0], left)
    _spectrum(axes[1, 1], left)
    if left.speed is not None:
        _against(axes[2, 0], left, left.speed, f"speed ({left.speed_unit})", "Residual against speed")
    if left.angle is not None:
        _against(axes[2, 1], left, left.angle, "shaft angle on the turn (deg)", "Residual against angle")
    else:
        axes[2, 1].set_visible(False)
    return figure


def _legend(axes: Axes) -> None:
    """A legend in a strip of its own above the curves."""
    low, high = axes.get_ylim()
    log = axes.get_yscale() == "log"
    axes.set_ylim(low, high * (high / low) ** LEGEND_ROOM if log else high + LEGEND_ROOM * (high - low))
    axes.legend(loc="upper right", fontsize=7.5, ncols=3)


def _over_time(axes: Axes, left: Residual) -> None:
    time_s, low, mean, high = band(left.time_s, left.error)
    axes.fill_between(time_s, low, high, color=AFTER, alpha=0.25, linewidth=0, label="least to greatest")
    axes.plot(time_s, mean, color=AFTER, linewidth=1.1, label="mean")
    axes.set(xlabel="time (s)", ylabel=f"error ({left.unit})", title="Residual over time")
    _legend(axes)


def _histogram(axes: Axes, left: Residual) -> None:
    wide = max(float(np.quantile(np.abs(left.error), 0.999)), 1e-12)
    edges = np.linspace(-wide, wide, BINS + 1)
    share = np.histogram(left.error, edges)[0] / len(left.error) * 100.0
    axes.bar(edges[:-1], share, np.diff(edges), align="edge", color="#9DBBD0", label="errors")
    x = np.linspace(-wide, wide, 200)
    spread = float(left.error.std()) or 1e-12
    normal = np.exp(-0.5 * ((x - left.error.mean()) / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
    axes.plot(x, 100.0 * normal * (edges[1] - edges[0]), color=BEFORE, linestyle=(0, (5, 2)), label="normal")
    if left.quantum > 0 and left.quantum < 4.0 * wide:
        for edge in (-0.5 * left.quantum, 0.5 * left.quantum):
            axes.axvline(edge, color=FLOOR, linestyle=(0, (4, 2)), linewidth=1.3)
        axes.plot([], [], color=FLOOR, linestyle=(0, (4, 2)), label="one count")
    axes.set(xlabel=f"error ({left.unit})", ylabel="share of samples (%)", title="Histogram")
    _legend(axes)


def _autocorrelation(axes: Axes, left: Residual) -> None:
    lag_s = np.arange(len(left.correlation)) * left.sample_time_s
    axes.axhspan(-left.chance, left.chance, color=FLOOR, alpha=0.25, linewidth=0, label="99 % by chance")
    axes.plot(lag_s, left.correlation, color=AFTER, marker=".", markersize=3, linewidth=0.9)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set(xlabel="lag (s)", ylabel="correlation coefficient", title="Autocorrelation")
    _legend(axes)


def _spectrum(axes: Axes, left: Residual) -> None:
    length = max(16, min(len(left.error), 2 ** int(np.log2(max(16, 2 * len(left.error) // (SEGMENTS + 1))))))
    frequency, power = welch(left.error - left.error.mean(), fs=1.0 / left.sample_time_s, nperseg=length)
    axes.loglog(frequency[1:], np.sqrt(np.maximum(power[1:], 1e-30)), color=AFTER, linewidth=1.0)
    few = float(np.ptp(np.log10(np.sqrt(np.maximum(power[1:], 1e-30))))) < FEW_DECADES
    for axis, subs in ((axes.xaxis, (1.0,)), (axes.yaxis, (1.0, 2.0, 5.0) if few else (1.0,))):
        axis.set_major_locator(LogLocator(subs=subs))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    level = left.rms * np.sqrt(2.0 * left.sample_time_s)
    axes.axhline(level, color=FLOOR, linestyle=(0, (4, 2)), linewidth=1.3, label="white noise of the same rms")
    axes.set(xlabel="frequency (Hz)", ylabel=f"amplitude density ({left.unit}/√Hz)", title="Spectrum")
    _legend(axes)


def _against(axes: Axes, left: Residual, x: Array, label: str, title: str) -> None:
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
    bins = np.clip(np.digitize(x, edges) - 1, 0, max(len(edges) - 2, 0))
    kept = [left.error[bins == i] for i in range(max(len(edges) - 1, 1))]
    centres = np.array([x[bins == i].mean() for i, part in enumerate(kept) if len(part)])
    kept = [part for part in kept if len(part)]
    low, high = (np.array([np.quantile(part, q) for part in kept]) for q in (0.1, 0.9))
    axes.fill_between(centres, low, high, color=AFTER, alpha=0.25, linewidth=0, label="80 % of the errors")
    axes.plot(centres, [part.mean() for part in kept], color=AFTER, marker=".", linewidth=1.1, label="mean")
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set(xlabel=label, ylabel=f"error ({left.unit})", title=title)
    _legend(axes)
