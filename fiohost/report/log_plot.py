"""Logs as pictures: angle, speed and duty over time, the phase plane, the spectrum, a model beside."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fiohost.report.log_series import LogSeries, spectrum_of
from fiohost.report.plots import BEFORE, GREY, LINE_CYCLE, MEASURED, PIECES, STYLE, band, canvas, thin
from fiohost.report.series import Array
from fiohost.report.words import number

MOST_LINES = 12  # of text below a picture
LINE_IN = 0.16
UNITS = {"C": "°C", "Nm": "N m"}


@matplotlib.rc_context(STYLE)
def plot_logs(series: Sequence[LogSeries], title: str, lines: Sequence[str] = ()) -> Figure:
    """Panels over time: output (with a reference and a model), its error, speed, duty, what was measured beside.

    *lines* stand below as text.
    """
    simulated = any(s.simulated is not None for s in series)
    beside = list(dict.fromkeys(name for s in series for name in s.beside))[:4]
    panels = ["output", *(["error"] if simulated else [])]
    panels += ["speed"] if any(s.speed is not None for s in series) else []
    panels += ["duty", *beside]
    heights = [2.4 if p == "output" else 1.5 if p == "speed" else 1.1 for p in panels]
    shown = list(lines)[:MOST_LINES]
    figure = canvas(9.5, 0.9 + 1.05 * sum(heights) + LINE_IN * len(shown))
    room = (LINE_IN * len(shown) + 0.1) / figure.get_size_inches()[1] if shown else 0.0
    figure.set_layout_engine("constrained", rect=(0, room, 1, 1 - room))
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights})[:, 0]
    figure.suptitle(title, fontsize=12, fontweight="bold", x=0.01, ha="left")
    for panel, axes in zip(panels, grid, strict=True):
        for place, one in enumerate(series):
            _panel(axes, panel, one, _colour(place, len(series)), len(series) > 1)
        axes.margins(x=0.01)
        handles = axes.get_legend_handles_labels()[0]
        if panel == "output" and (len(handles) > 1 or len(series) > 1):
            axes.legend(loc="best", fontsize=8)
        elif panel == "error":
            axes.legend(
                loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, ncols=min(len(handles), 4), borderpad=0.1
            )
    grid[-1].set_xlabel("time (s)")
    if shown:
        figure.text(0.012, 0.004, "\n".join(shown), fontsize=8, va="bottom", ha="left", linespacing=1.35)
    return figure


@matplotlib.rc_context(STYLE)
def plot_phase(series: Sequence[LogSeries], title: str) -> Figure:
    """Speed over angle or position; of a log of speeds, speed over duty."""
    figure = canvas(8.0, 6.0)
    axes = figure.subplots()
    for place, one in enumerate(series):
        colour = _colour(place, len(series))
        if one.speed is None:
            axes.plot(one.duty_pct, one.output, ".", markersize=2, color=colour, label=one.name)
            axes.set_xlabel("duty (%)")
            axes.set_ylabel(f"speed ({one.unit})")
        else:
            axes.plot(one.output, one.speed, color=colour, linewidth=0.8, label=one.name)
            axes.set_xlabel(f"{one.quantity} ({one.unit})")
            axes.set_ylabel(f"speed ({one.speed_unit})")
    axes.set_title(title)
    if len(series) > 1:
        axes.legend(loc="best", fontsize=8)
    return figure


@matplotlib.rc_context(STYLE)
def plot_spectrum(series: Sequence[LogSeries], title: str) -> Figure:
    """Amplitude density of speed and duty over frequency, of the model's error too where there is one."""
    simulated = any(s.simulated is not None for s in series)
    figure = canvas(8.5, 6.5 if not simulated else 8.5)
    rows = figure.subplots(3 if simulated else 2, 1, sharex=True)
    for place, one in enumerate(series):
        colour = _colour(place, len(series))
        unit = one.unit if one.speed is None else one.speed_unit
        wanted = [
            (rows[0], one.output, f"speed\n({unit} per √Hz)", one.speed is not None),
            (rows[1], one.duty_pct, "duty\n(% per √Hz)", False),
        ]
        if one.simulated is not None:
            wanted.append((rows[2], one.output - one.simulated, f"measured - simulated\n({one.unit} per √Hz)", False))
        for axes, values, label, slope in wanted:
            frequencies, density = spectrum_of(one, values, slope)
            if density.max() > 0.0:
                shown = np.maximum(density, 1e-6 * density.max())
                axes.loglog(frequencies, shown, color=colour, linewidth=1.0, label=one.name)
            axes.set_ylabel(label)
    rows[0].set_title(title)
    rows[-1].set_xlabel("frequency (Hz)")
    if len(series) > 1:
        rows[0].legend(loc="best", fontsize=8)
    return figure


def _panel(axes: Axes, panel: str, one: LogSeries, colour: str, several: bool) -> None:
    if panel == "output":
        if one.ref is not None:
            axes.plot(one.time_s, one.ref, color=GREY, linewidth=1.0, label=None if several else "reference")
        _draw(axes, one.time_s, one.output, colour, one.name if several else "measured")
        if one.simulated is not None:
            at = thin(one.time_s, one.simulated)
            axes.plot(
                one.time_s[at], one.simulated[at], color=BEFORE if not several else colour, linewidth=1.1,
                linestyle=(0, (5, 2)), label=f"{one.model}{f' ({one.name})' if several else ''}",
            )  # fmt: skip
        axes.set_ylabel(f"{one.quantity} ({one.unit})")
    elif panel == "error" and one.simulated is not None:
        label = f"{one.name + ': ' if several else ''}{number(one.error_rms, 3)} {one.unit} rms"
        _draw_error(axes, one.time_s, one.output - one.simulated, BEFORE if not several else colour, label)
        axes.axhline(0.0, color=GREY, linewidth=0.7)
        axes.set_ylabel(f"measured -\nsimulated ({one.unit})")
    elif panel == "speed" and one.speed is not None:
        _draw(axes, one.time_s, one.speed, colour, one.name)
        axes.set_ylabel(f"speed ({one.speed_unit})")
    elif panel == "duty":
        axes.step(one.time_s, one.duty_pct, where="post", color=colour, linewidth=1.0)
        axes.set_ylabel("duty (%)")
    elif panel in one.beside:
        _draw(axes, one.time_s, one.beside[panel], colour, one.name)
        axes.set_ylabel(label_of(panel))


def label_of(column: str) -> str:
    """``current_A`` as people write it: current (A)."""
    name, _, unit = column.rpartition("_")
    return f"{name.replace('_', ' ')} ({UNITS.get(unit, unit)})"


def _draw(axes: Axes, time_s: Array, values: Array, colour: str, label: str) -> None:
    at = thin(time_s, values)
    axes.plot(time_s[at], values[at], color=colour, linewidth=1.2, label=label)


def _draw_error(axes: Axes, time_s: Array, error: Array, colour: str, label: str) -> None:
    """A long one as its mean in a band from the least to the greatest: as a line it would be a block."""
    if len(error) <= PIECES:
        _draw(axes, time_s, error, colour, label)
        return
    at_s, low, mean, high = band(time_s, error)
    axes.fill_between(at_s, low, high, color=colour, alpha=0.28, linewidth=0, label="least to greatest")
    axes.plot(at_s, mean, color=colour, linewidth=1.1, label=f"mean, {label}")


def _colour(place: int, many: int) -> str:
    return MEASURED if many == 1 else LINE_CYCLE[place % len(LINE_CYCLE)]
