"""Identified loops as a picture: angle or speed after a step, measured and simulated, and the error over the log."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from fiohost.estimation.logs import Curve as LogCurve
from fiohost.report.panels import Curve, Panel, plot_panels

SHOWN = 0.4  # of the time from one step to the next


def plot_identification(title: str, curves: Mapping[str, LogCurve]) -> Figure:
    """Curves of one log by what simulated them, such as "pem: K = 10.2"; the angle as on an oscilloscope above."""
    first = next(iter(curves.values()))
    begin, end = _window(first)
    shown = (first.time_s >= begin) & (first.time_s <= end)
    above = [Curve(first.time_s[shown], first.measured[shown], "measured", -2)]
    if first.ref_deg is not None:
        above.insert(0, Curve(first.time_s[shown], first.ref_deg[shown], "reference", -1, "reference"))
    below = []
    for i, (label, curve) in enumerate(curves.items()):
        inside = (curve.time_s >= begin) & (curve.time_s <= end)
        above.append(Curve(curve.time_s[inside], curve.simulated[inside], label, i, "model"))
        error = curve.measured - curve.simulated
        said = f"{label.partition(':')[0]}: {np.sqrt(np.mean(error**2)):.2g} {curve.unit} rms"
        below.append(Curve(curve.time_s, error, said, i, "reference"))
    return plot_panels(
        [
            Panel(above, f"{'angle' if first.unit == 'deg' else 'speed'} ({first.unit})", x_limits=(begin, end)),
            Panel(
                below,
                f"measured - simulated\n({first.unit})",
                x_limits=(float(first.time_s[0]), float(first.time_s[-1])),
            ),
        ],
        title,
    )


def _window(curve: LogCurve) -> tuple[float, float]:
    """A step of the reference until its response is over; without a reference, or with one step, all."""
    begin, end = float(curve.time_s[0]), float(curve.time_s[-1])
    if curve.ref_deg is None:
        return begin, end
    edges = curve.time_s[1:][np.diff(curve.ref_deg) != 0.0]
    if edges.size < 2:
        return begin, end
    length = float(edges[1] - edges[0])
    return float(edges[0]) - 0.03 * length, float(edges[0]) + SHOWN * length
