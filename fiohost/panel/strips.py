"""The strip charts of the window: duty, angle and speed over the last seconds; paused, zoomed, kept as a log."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from fiohost.bench.writer import SCHEMA
from fiohost.panel.link import READING_S, Facts, Reading
from fiohost.report.plots import AFTER, BEFORE, GREY

SPANS_S = (5.0, 10.0, 30.0, 60.0)
SPAN_S = 10.0  # at first
MOST = 30_000  # readings that are kept: ten minutes
POINTS = 3000  # drawn of a line: finer than a screen
SPEED_OVER_S = 0.2  # a count is half a degree: over one tick it would be 100 deg/s
SPEED_SCALES = (50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0)
SHORTEST_S = 0.1  # that a zoom shows
LEFT, BOTTOM, STEP, HEIGHT = 0.425, 0.715, 0.205, 0.18
INK = "#222222"


class Strips:
    """Three charts, up to *right*: ``take`` readings, ``draw`` them. ``moving`` is what a frame repaints."""

    def __init__(self, figure: Figure, facts: Facts, right: float) -> None:
        self._facts = facts
        self._readings: list[Reading] = []
        self._times: list[float] = []
        self._speeds: list[float] = []
        self._span_s = SPAN_S
        self._still: tuple[float, float] | None = None  # what is shown while paused, in seconds of the run
        self._drag_s: float | None = None
        limit = facts.limit_pct
        rows = (("duty (%)", -1.08 * limit, 1.08 * limit), ("angle (deg)", 0.0, 360.0), ("speed (deg/s)", -50.0, 50.0))
        self._lines: list[Line2D] = []
        self._charts: list[Axes] = []
        for i, (label, low, high) in enumerate(rows):
            axes = figure.add_axes((LEFT, BOTTOM - STEP * i, right - LEFT, HEIGHT))
            axes.set(xlim=(-SPAN_S, 0.0), ylim=(low, high), ylabel=label)
            axes.yaxis.set_label_coords(-0.095, 0.5)
            axes.tick_params(labelsize=9, labelbottom=i == len(rows) - 1)
            (line,) = axes.plot([], [], color=(INK, BEFORE, AFTER)[i], linewidth=1.5)
            self._lines.append(line)
            self._charts.append(axes)
        self._charts[1].set_yticks(range(0, 361, 90))
        (self._reference,) = self._charts[1].plot([], [], color=GREY, linewidth=1.2, linestyle="--")
        self.moving: list[Artist] = [self._reference, *self._lines]

    # ---- what comes -----------------------------------------------------------------------------------------------

    @property
    def last(self) -> tuple[Reading, float] | None:
        """The newest reading and its speed in deg/s."""
        return (self._readings[-1], self._speeds[-1]) if self._readings else None

    def take(self, reading: Reading) -> None:
        """Keep one more reading."""
        self._speeds.append(self._speed_deg_s(reading))
        self._readings.append(reading)
        self._times.append(reading.time_s)
        if len(self._readings) > MOST:
            for column in (self._readings, self._times, self._speeds):
                del column[: MOST // 10]

    def _speed_deg_s(self, now: Reading) -> float:
        """Mean speed over the last SPEED_OVER_S."""
        at = bisect_left(self._times, now.time_s - SPEED_OVER_S + 1e-9) - 1
        past = self._readings[at] if at >= 0 else None
        return (now.angle_deg - past.angle_deg) / (now.time_s - past.time_s) if past else 0.0

    # ---- what of it is shown --------------------------------------------------------------------------------------

    @property
    def paused(self) -> bool:
        return self._still is not None

    @property
    def shown_s(self) -> tuple[float, float]:
        """From where to where, in seconds of the run."""
        end = self._times[-1] if self._times else 0.0
        return self._still or (end - self._span_s, end)

    def pause(self, wanted: bool) -> None:
        """Hold the charts, never the motor; or go on."""
        self._still = self.shown_s if wanted else None

    def span(self, seconds: float) -> None:
        """Show the last so many seconds, and go on."""
        self._span_s, self._still = seconds, None

    def everything(self) -> None:
        """Pause and show all that is kept."""
        if self._times:
            self.zoom(self._times[0], self._times[-1])

    def zoom(self, from_s: float, to_s: float) -> None:
        """Pause and show this part of the run."""
        self._still = (from_s, max(to_s, from_s + SHORTEST_S))

    def press(self, event: Any) -> bool:
        """A mouse button went down; whether that was in a chart. Twice is: go on."""
        if event.inaxes not in self._charts:
            return False
        self._drag_s = None if event.dblclick else self._seconds(event.xdata)
        if event.dblclick:
            self.pause(False)
        return True

    def release(self, event: Any) -> bool:
        """It came up; whether another part is to be shown."""
        began, self._drag_s = self._drag_s, None
        if began is None or event.inaxes not in self._charts:
            return False
        ends = sorted((began, self._seconds(event.xdata)))
        if ends[1] - ends[0] < SHORTEST_S:
            return False
        self.zoom(*ends)
        return True

    def _seconds(self, x: float) -> float:
        """Seconds of the run at a place of the axis, which tells seconds ago unless it is paused."""
        return float(x) if self.paused or not self._times else float(x) + self._times[-1]

    def csv(self) -> str:
        """A log of what is shown: all readings that are kept, or, paused, those in sight."""
        from_s, to_s = self._still or (-np.inf, np.inf)
        head = [
            f"# schema: {SCHEMA}",
            f"# target: {self._facts.target}",
            "# experiment: panel, as shown",
            f"# sample_time_s: {READING_S:g}",
            f"# counts_per_rev: {self._facts.counts_per_rev}",
            "time_s,duty_pct,c3,c4,pos,direction,ref_deg,angle_deg",
        ]
        for r in self._readings[bisect_left(self._times, from_s) : bisect_right(self._times, to_s)]:
            ref = "" if r.ref_deg is None else f"{r.ref_deg:g}"
            head.append(f"{r.time_s:.6g},{r.duty_pct:g},{r.c3},{r.c4},{r.pos},{r.direction},{ref},{r.angle_deg:.8g}")
        return "\n".join(head) + "\n"

    # ---- drawing --------------------------------------------------------------------------------------------------

    def draw(self) -> bool:
        """Put what is shown into the lines; whether axes changed, so that all must be drawn anew."""
        from_s, to_s = self.shown_s
        first, end = bisect_left(self._times, from_s), bisect_right(self._times, to_s)
        every = max(1, (end - first) // POINTS)
        kept = slice(first, end, every)
        turn = 360.0 / self._facts.counts_per_rev
        readings = self._readings[kept]
        zero = 0.0 if self.paused else to_s
        x = np.array(self._times[kept]) - zero
        angle = np.array([(r.pos + 1) * turn for r in readings])
        if angle.size:  # no line across the chart where the angle begins anew
            angle[np.abs(np.diff(angle, prepend=angle[0])) > 180.0] = np.nan
        speed = np.array(self._speeds[kept])
        for line, values in zip(self._lines, (np.array([r.duty_pct for r in readings]), angle, speed), strict=True):
            line.set_data(x, values)
        refs = [np.nan if r.ref_deg is None else (r.ref_deg + turn) % 360.0 for r in readings]
        self._reference.set_data(x, refs)
        return self._set_axes(from_s - zero, to_s - zero, float(np.abs(speed).max()) if speed.size else 0.0)

    def _set_axes(self, low: float, high: float, fastest: float) -> bool:
        changed = False
        label = "seconds of the run" if self.paused else "seconds ago"
        bottom = self._charts[-1]
        if bottom.get_xlabel() != label or not np.allclose(bottom.get_xlim(), (low, high), rtol=0.0, atol=1e-6):
            bottom.set_xlabel(label)
            for axes in self._charts:
                axes.set_xlim(low, high)
            changed = True
        scale = next((s for s in SPEED_SCALES if s > 1.05 * fastest), SPEED_SCALES[-1])
        if scale != bottom.get_ylim()[1]:
            bottom.set_ylim(-scale, scale)
            changed = True
        return changed
