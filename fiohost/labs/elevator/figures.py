"""Pictures of the elevator: height against time with the floors marked, the duty below."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fiohost.labs.elevator.buttons import Press
from fiohost.labs.elevator.car import FLOORS, Record, floor_cm, floor_of
from fiohost.labs.elevator.experiment import Run, Series
from fiohost.report.plots import FLOOR, GREY, LINE_CYCLE, MEASURED, STYLE

ROOM_CM = 1.2  # above and below


@matplotlib.rc_context(STYLE)
def plot_series(part: Series) -> Figure:
    """All designs of a table: a colour each on the target, black dashes on the model."""
    top, low = _canvas()
    runs = list(part.runs.items())
    _line(top, runs[0][1].target, "ref_cm", GREY, "asked for")
    for (name, run), colour in zip(runs, cycle(LINE_CYCLE), strict=False):
        _line(top, run.target, "height_cm", colour, f"{name}, target")
        _line(low, run.target, "duty_pct", colour)
    for i, (_, run) in enumerate(runs):
        _line(top, run.model, "height_cm", MEASURED, "model" if i == 0 else None, dashed=True)
        _line(low, run.model, "duty_pct", MEASURED, dashed=True)
    return _finish(top, low, part.title, 2)


@matplotlib.rc_context(STYLE)
def plot_ride(run: Run, presses: Sequence[Press]) -> Figure:
    """A ride by buttons, the time for which each button was held shaded."""
    top, low = _canvas()
    for button, colour in (("up", LINE_CYCLE[3]), ("down", LINE_CYCLE[5])):
        held = [p for p in presses if p.button == button]
        for i, press in enumerate(held):
            label = f"{button} button held" if i == 0 else None
            top.axvspan(press.at_s, press.at_s + press.held_s, color=colour, alpha=0.5, linewidth=0, label=label)
    _line(top, run.target, "height_cm", LINE_CYCLE[0], "target")
    _line(top, run.model, "height_cm", MEASURED, "model", dashed=True)
    _line(low, run.target, "duty_pct", LINE_CYCLE[0])
    _line(low, run.model, "duty_pct", MEASURED, dashed=True)
    _line(top, run.target, "ref_cm", GREY, "asked for")
    return _finish(top, low, f"Ride by buttons: {run.design.label}", floor_of(float(run.target.ref_cm.max())))


def _canvas() -> tuple[Axes, Axes]:
    figure = Figure(figsize=(9.0, 5.8), layout="constrained")
    FigureCanvasAgg(figure)
    top, low = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": [3, 1]})
    return top, low


def _line(axes: Axes, record: Record, what: str, colour: str, label: str | None = None, dashed: bool = False) -> None:
    asked = what == "ref_cm"
    style = ":" if asked else (0, (4, 2)) if dashed else "-"
    axes.plot(
        record.time_s, getattr(record, what), color=colour, linestyle=style, linewidth=1.1 if dashed or asked else 1.5,
        drawstyle="steps-post" if asked else "default", label=label,
    )  # fmt: skip


def _finish(top: Axes, low: Axes, title: str, highest: int) -> Figure:
    """Floors as green lines with their numbers on the right, axes named."""
    for floor in range(1, FLOORS + 1):
        top.axhline(floor_cm(floor), color=FLOOR, linewidth=1.0, alpha=0.7, zorder=1.5)
    shown = range(1, max(highest, 2) + 1)
    top.set_ylim(-ROOM_CM, floor_cm(shown[-1]) + ROOM_CM)
    floors = top.secondary_yaxis("right")
    floors.set_yticks([floor_cm(n) for n in shown], [str(n) for n in shown])
    floors.set_ylabel("floor", color=FLOOR)
    floors.tick_params(colors=FLOOR)
    top.set_ylabel("height (cm)")
    top.set_title(title)
    top.legend(loc="upper left", bbox_to_anchor=(1.06, 1.0))
    low.set_ylabel("duty (%)")
    low.set_ylim(-108.0, 108.0)
    low.set_xlabel("time (s)")
    low.margins(x=0.0)
    figure = top.figure
    assert isinstance(figure, Figure)
    return figure
