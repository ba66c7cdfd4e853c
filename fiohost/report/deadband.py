"""The deadband sweep as a picture: duty and angle against time for every start, and the starts over the turn."""

from __future__ import annotations

from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fiohost.bench.deadband import Deadband
from fiohost.report.plots import AFTER, BEFORE, STYLE

METHOD_WORDS = {"ramp": "slow ramps", "steps": "steps from rest"}


@matplotlib.rc_context(STYLE)
def plot_deadband(deadband: Deadband, target: str) -> Figure:
    """Forward on the left, reverse on the right: duty acting, angle from rest, starts by the shaft's angle."""
    figure = Figure(figsize=(9.5, 7.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(3, 2)
    what = "ramp" if deadband.method == "ramp" else "first step"
    for column, forward in enumerate((True, False)):
        top, bottom, around = axes[0][column], axes[1][column], axes[2][column]
        bottom.sharex(top)
        color = AFTER if forward else BEFORE
        found = [o for o in deadband.onsets if o.forward == forward]
        for i, onset in enumerate(found):
            top.plot(onset.time_s, onset.duty_acting_pct, color=color, alpha=0.45, linewidth=1.2)
            bottom.plot(onset.time_s, onset.moved_deg, color=color, alpha=0.7, linewidth=1.2,
                        label="angle, one line a start" if i == 0 else None)  # fmt: skip
            marked = {"color": "black", "marker": "o", "markersize": 4, "linestyle": "none", "zorder": 5}
            top.plot([onset.onset_s], [onset.duty_pct], **marked, label="start" if i == 0 else None)
            bottom.plot([onset.onset_s], [0.0], **marked)
        mean = deadband.u_plus_pct if forward else deadband.u_minus_pct
        spread = deadband.spread_pct(forward)
        name = "u+" if forward else "u−"
        top.axhspan(mean - spread, mean + spread, color="black", alpha=0.10, linewidth=0)
        label = f"mean {mean:.2f} %, grey ± {spread:.3f} %"
        top.axhline(mean, color="black", linewidth=1.0, linestyle="--", label=label)
        top.set_title(f"{'Forward' if forward else 'Reverse'}: {name} = {mean:.2f} % ± {spread:.3f} %")
        top.set_ylabel("duty acting (%)")
        bottom.set_ylabel("angle from rest (deg)")
        bottom.set_xlabel(f"time since the {what} began (s)")
        around.plot([o.at_angle_deg for o in found], [o.duty_pct for o in found], color=color, marker="o",
                    markersize=5, linestyle="none", alpha=0.7, label="starts")  # fmt: skip
        around.axhline(mean, color="black", linewidth=1.0, linestyle="--", label="mean")
        room = max(3.0 * spread, 0.1 * abs(mean), 0.05)
        around.set_ylim(mean - room, mean + room)
        around.set_xlim(0.0, 360.0)
        around.set_xticks(range(0, 361, 60))
        around.set_xlabel("angle of the shaft at rest (deg)")
        around.set_ylabel("duty at start (%)")
        around.legend(loc="best")
        top.legend(loc="best")
        bottom.legend(loc="upper left" if forward else "lower left")
    figure.suptitle(
        f"Deadband of {target}: {len(found)} starts by {METHOD_WORDS[deadband.method]} in each direction", fontsize=12
    )
    return figure
