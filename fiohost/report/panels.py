"""Curves in panels: the pictures of the labs. Colour tells the case, line style who it is (model or measurement)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fiohost.report.plots import GREY, LINE_CYCLE, MEASURED, STYLE

STYLES: dict[str, dict[str, Any]] = {
    "target": {"linestyle": "-", "linewidth": 3.2, "alpha": 0.4, "zorder": 2},
    "model": {"linestyle": (0, (5, 2)), "linewidth": 1.5, "zorder": 4},
    "ideal": {"linestyle": (0, (1, 1.5)), "linewidth": 1.3, "zorder": 3},
    "plain": {"linestyle": "-", "linewidth": 1.6},
    "reference": {"linestyle": "-", "linewidth": 0.9, "alpha": 0.8},
    "points": {"linestyle": "none", "marker": "o", "markersize": 5.5},
    "crosses": {"linestyle": "none", "marker": "x", "markersize": 6.5, "markeredgewidth": 1.6},
}


@dataclass(frozen=True)
class Curve:
    """One line: ``case`` picks the colour (-1 grey, -2 black), ``style`` one of STYLES. No label: not in the legend."""

    x: Any
    y: Any
    label: str = ""
    case: int = 0
    style: str = "target"


@dataclass(frozen=True)
class Panel:
    """Curves on the same axes, with quantities and units in their labels."""

    curves: Sequence[Curve]
    y_label: str
    x_label: str = "time (s)"
    title: str = ""
    log_x: bool = False
    x_limits: tuple[float, float] | None = None
    y_limits: tuple[float, float] | None = None


@matplotlib.rc_context(STYLE)
def plot_panels(panels: Sequence[Panel], title: str, columns: int = 1, panel_height: float = 3.0) -> Figure:
    """Panels row by row, each with its own legend beside what it explains."""
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(4.2 + 4.8 * columns, 0.6 + panel_height * rows), layout="constrained")
    FigureCanvasAgg(figure)
    places = np.atleast_1d(np.asarray(figure.subplots(rows, columns, squeeze=False))).ravel()
    for axes, panel in zip(places, panels, strict=False):
        for curve in panel.curves:
            color = {-1: GREY, -2: MEASURED}.get(curve.case) or LINE_CYCLE[curve.case % len(LINE_CYCLE)]
            axes.plot(curve.x, curve.y, color=color, label=curve.label or None, **STYLES[curve.style])
        axes.set_xlabel(panel.x_label)
        axes.set_ylabel(panel.y_label)
        axes.set_title(panel.title)
        if panel.log_x:
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter("{x:g}")
        if panel.x_limits:
            axes.set_xlim(*panel.x_limits)
        if panel.y_limits:
            axes.set_ylim(*panel.y_limits)
        if any(curve.label for curve in panel.curves):
            axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    for axes in places[len(panels) :]:
        axes.set_visible(False)
    figure.suptitle(title, fontsize=12, x=0.01, ha="left")
    return figure
