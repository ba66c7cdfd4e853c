"""Pictures of the elevator: height against time with the floors marked, the error on its own scale, the duty."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fiohost.labs.elevator.buttons import Press
from fiohost.labs.elevator.car import MOST_ERROR_CM, TOP_FLOOR, Record, floor_cm, floor_of
from fiohost.labs.elevator.experiment import Run, Series
from fiohost.report.plots import FLOOR, GREY, LINE_CYCLE, MEASURED, STYLE

ROOM_CM = 1.2  # above and below
ERROR_CM = 0.45  # shown of the error; the way itself is in the panel above


@matplotlib.rc_context(STYLE)
def plot_series(part: Series) -> Figure:
    """All designs of a table: a colour each on the target, black dashes on the model."""
    panels = _panels()
    runs = list(part.runs.items())
    _asked(panels[0], runs[0][1].target)
    for (name, run), colour in zip(runs, cycle(LINE_CYCLE), strict=False):
        _draw(panels, run.target, colour, f"{name}, target")
    for i, (_, run) in enumerate(runs):
        _draw_ideal(panels[0], run, "ideal, 4.5 V and 1 A" if i == 0 else None)
        _draw(panels, run.model, MEASURED, "model" if i == 0 else None, dashed=True)
    return _finish(panels, part.title, 1)


@matplotlib.rc_context(STYLE)
def plot_ride(run: Run, presses: Sequence[Press]) -> Figure:
    """A ride by buttons, the time for which each button was held shaded."""
    panels = _panels()
    for button, colour in (("up", LINE_CYCLE[3]), ("down", LINE_CYCLE[5])):
        for i, press in enumerate(p for p in presses if p.button == button):
            label = f"{button} button held" if i == 0 else None
            end_s = press.at_s + press.held_s
            panels[0].axvspan(press.at_s, end_s, color=colour, alpha=0.5, linewidth=0, label=label)
    _asked(panels[0], run.target)
    _draw(panels, run.target, LINE_CYCLE[0], "target")
    _draw(panels, run.model, MEASURED, "model", dashed=True)
    return _finish(panels, f"Ride by buttons: {run.design.label}", floor_of(float(run.target.ref_cm.max())))


def _panels() -> list[Axes]:
    figure = Figure(figsize=(9.0, 6.6), layout="constrained")
    FigureCanvasAgg(figure)
    return list(figure.subplots(3, 1, sharex=True, gridspec_kw={"height_ratios": [3.0, 1.2, 1.0]}))


def _asked(axes: Axes, record: Record) -> None:
    axes.plot(record.time_s, record.ref_cm, color=GREY, linestyle=":", drawstyle="steps-post", label="asked for")


def _draw(panels: Sequence[Axes], record: Record, colour: str, label: str | None, *, dashed: bool = False) -> None:
    style: dict[str, Any] = (
        {"linestyle": (0, (4, 3)), "linewidth": 0.9} if dashed else {"linestyle": "-", "linewidth": 1.7}
    )
    for axes, y in zip(panels, (record.height_cm, record.ref_cm - record.height_cm, record.duty_pct), strict=True):
        axes.plot(record.time_s, y, color=colour, label=label, **style)


def _draw_ideal(axes: Axes, run: Run, label: str | None) -> None:
    """The block diagram's response, put where the target's first move begins."""
    if run.ideal is not None:
        begin_s = float(run.target.time_s[np.argmax(run.target.ref_cm > 0.0)])
        axes.plot(run.ideal.time_s + begin_s, run.ideal.height_cm, color=GREY, linewidth=0.9, label=label)


def _finish(panels: Sequence[Axes], title: str, highest: int) -> Figure:
    """Floors as green lines with their numbers on the right, the allowed error as a green band, axes named."""
    height, error, duty = panels
    for floor in range(TOP_FLOOR + 1):
        height.axhline(floor_cm(floor), color=FLOOR, linewidth=1.0, alpha=0.7, zorder=1.5)
    shown = range(max(highest, 1) + 1)
    height.set_ylim(-ROOM_CM, floor_cm(shown[-1]) + ROOM_CM)
    floors = height.secondary_yaxis("right")
    floors.set_yticks([floor_cm(n) for n in shown], [str(n) for n in shown])
    floors.set_ylabel("floor", color=FLOOR)
    floors.tick_params(colors=FLOOR)
    height.set_ylabel("height (cm)")
    height.set_title(title)
    error.axhspan(-MOST_ERROR_CM, MOST_ERROR_CM, color=FLOOR, alpha=0.2, linewidth=0, label="1 mm allowed")
    error.set_ylim(-ERROR_CM, ERROR_CM)
    error.set_ylabel("error (cm)")
    duty.set_ylabel("duty (%)")
    duty.set_ylim(-108.0, 108.0)
    duty.set_xlabel("time (s)")
    duty.margins(x=0.0)
    lines, labels = height.get_legend_handles_labels()
    band, words = error.get_legend_handles_labels()
    height.legend([*lines, band[-1]], [*labels, words[-1]], loc="upper left", bbox_to_anchor=(1.06, 1.0))
    figure = height.figure
    assert isinstance(figure, Figure)
    figure.align_ylabels(panels)
    return figure
