"""The picture of the panel: slider, buttons, dial, readings and strip charts, on any matplotlib figure.

What never changes is drawn once and kept; a frame puts that back and draws the moving parts over it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.backend_bases import Event
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch, Rectangle
from matplotlib.widgets import Slider

from fiohost.panel.link import Facts, News, Reading
from fiohost.panel.strips import Strips
from fiohost.report.plots import AFTER, BEFORE, FLOOR, GREY, STYLE

SIZE_IN = (10.8, 6.6)
DPI = 100
LEFT, RIGHT, WIDTH = 0.04, 0.98, 0.67  # edges of the page, and the slider's width
RED, PALE_RED, INK, PALE, HOVER = "#C62828", "#E8A6A6", "#222222", "#ECEFF1", "#DDE3E7"
MODES = {"drive": AFTER, "brake": GREY, "standby": FLOOR}
KEYS: dict[str, tuple[str, float | None]] = {
    "up": ("change", 1.0),
    "down": ("change", -1.0),
    "shift+up": ("change", 10.0),
    "shift+down": ("change", -10.0),
    "pageup": ("change", 10.0),
    "pagedown": ("change", -10.0),
    " ": ("brake", None),
    "s": ("standby", None),
    "r": ("reverse", None),
    "escape": ("emergency", None),
}

Act = Callable[[str, float | None], None]


class _Button:
    """A labelled box that acts when the mouse goes down on it, not when it comes up: a stop must not wait."""

    def __init__(self, figure: Figure, box: tuple[float, float, float, float], label: str, **text: Any) -> None:
        self.axes = figure.add_axes(box)
        self.axes.set_axis_off()
        self.axes.set(xlim=(0, 1), ylim=(0, 1))
        self._patch = FancyBboxPatch((0.0, 0.0), 1.0, 1.0, boxstyle="square,pad=0", linewidth=0.0, clip_on=True)
        self.axes.add_patch(self._patch)
        self._text = self.axes.text(0.5, 0.48, label, ha="center", va="center", **{"fontsize": 11.0, **text})

    def paint(self, face: str, ink: str, label: str | None = None) -> None:
        self._patch.set_facecolor(face)
        self._text.set_color(ink)
        if label is not None:
            self._text.set_text(label)


class View:
    """Draws on *figure* and calls *act* for what a person asks; ``show`` takes news, ``frame`` paints."""

    def __init__(self, figure: Figure, facts: Facts, act: Act) -> None:
        self.figure, self._facts, self._act = figure, facts, act
        self._background: Any = None
        self._stopped = False
        self._canvas: Any = figure.canvas
        canvas = self._canvas
        self._blit = hasattr(canvas, "copy_from_bbox") and hasattr(canvas, "blit")
        with matplotlib.rc_context(STYLE):
            self.strips = Strips(figure, facts, RIGHT)
            self._moving: list[Artist] = [*self._head(), *self._dial(), *self.strips.moving, *self._inputs()]
        for artist in self._moving:
            artist.set_animated(self._blit)
        canvas.mpl_connect("draw_event", self._on_draw)
        canvas.mpl_connect("button_press_event", self._on_press)
        canvas.mpl_connect("button_release_event", self._on_release)
        canvas.mpl_connect("key_press_event", self._on_key)

    # ---- what is drawn ------------------------------------------------------------------------------------------

    def _head(self) -> list[Artist]:
        text = self.figure.text
        logged = f"log {self._facts.log}" if self._facts.log else "no log"
        text(LEFT, 0.95, f"fiohost panel: {self._facts.target}", fontsize=13, fontweight="bold", va="center")
        text(RIGHT, 0.95, logged, fontsize=9, color=GREY, ha="right", va="center")
        self._status = text(LEFT, 0.022, "", fontsize=8.5, color=GREY, va="center")
        self._note = text(RIGHT, 0.022, "", fontsize=8.5, color=RED, ha="right", va="center")
        return [self._status, self._note]

    def _dial(self) -> list[Artist]:
        axes = self.figure.add_axes((0.022, 0.40, 0.30, 0.50))
        axes.set(xlim=(-1.22, 1.22), ylim=(-1.22, 1.22), aspect="equal")
        axes.set_axis_off()
        axes.add_patch(Circle((0, 0), 1.0, facecolor="#FAFAFA", edgecolor=INK, linewidth=1.5))
        for angle in range(0, 360, 10):
            x, y = _on_dial(angle)
            inner, width = (0.88, 1.4) if angle % 30 == 0 else (0.94, 0.7)
            axes.plot([inner * x, x], [inner * y, y], color=INK, linewidth=width)
            if angle % 30 == 0:
                label = "0/360" if angle == 0 else str(angle)
                axes.text(1.12 * x, 1.12 * y, label, ha="center", va="center", fontsize=8.5)
        (self._needle,) = axes.plot([], [], color=BEFORE, linewidth=5.0, solid_capstyle="round")
        self._angle = axes.text(0, 0, "", ha="center", va="center", fontsize=21, fontweight="bold")
        names = "POS\nspeed\ndirection"
        self.figure.text(LEFT, 0.325, names, fontsize=11, color=GREY, va="center", linespacing=1.5)
        self._values = self.figure.text(LEFT + 0.09, 0.325, "", fontsize=11, va="center", linespacing=1.5)
        return [self._needle, self._angle, self._values]

    def _inputs(self) -> list[Artist]:
        limit = self._facts.limit_pct
        axes = self.figure.add_axes((LEFT, 0.155, WIDTH, 0.04))
        self._slider = Slider(axes, "", -limit, limit, valinit=0.0, valstep=1.0, initcolor="none")
        self._slider.valtext.set_visible(False)
        self._slider.poly.set_visible(False)
        self._fill = Rectangle(
            (0.0, 0.25), 0.0, 0.5, transform=axes.get_xaxis_transform()
        )  # from zero, to the side it drives
        axes.add_patch(self._fill)
        self._slider.drawon = False
        self._slider.on_changed(lambda value: self._act("duty", float(value)))
        for i in range(-4, 5):
            share = i / 4
            x = LEFT + WIDTH * (1 + share) / 2
            label = _signed(share * limit, 0)
            self.figure.text(x, 0.14, label, fontsize=8.5, ha="center", va="center")
        self._duty = self.figure.text(LEFT, 0.225, "", fontsize=12, fontweight="bold", va="center")
        width, gap = 0.24 * WIDTH, 0.04 / 3 * WIDTH
        names = (("brake", "Brake"), ("standby", "Standby"), ("reverse", "Reverse"), ("release", "Release stop"))
        self._buttons = {
            name: _Button(self.figure, (LEFT + i * (width + gap), 0.052, width, 0.06), label)
            for i, (name, label) in enumerate(names)
        }
        big = {"fontsize": 16.0, "fontweight": "bold", "linespacing": 1.3}
        self._buttons["emergency"] = _Button(self.figure, (RIGHT - 0.23, 0.052, 0.23, 0.165), "EMERGENCY\nSTOP", **big)
        return [axes, self._duty, *(button.axes for button in self._buttons.values())]

    # ---- what changes -------------------------------------------------------------------------------------------

    def show(self, news: News, *, answered: bool = True) -> None:
        """Take news of the bench. *answered*: they know of all that was asked, so the slider may follow them."""
        for reading in news.readings:
            self.strips.take(reading)
        self._stopped = news.stopped
        if answered and not self._slider.drag_active:
            self._slider.eventson = False
            self._slider.set_val(news.duty_pct)
            self._slider.eventson = True
        self._duty.set_text("STOPPED: release to drive again" if news.stopped else _words(news))
        self._duty.set_color(RED if news.stopped else MODES[news.mode])
        self._fill.set_width(self._slider.val)
        self._fill.set_color(GREY if news.stopped else AFTER)
        for name, button in self._buttons.items():
            lit = name == news.mode and not news.stopped
            button.paint(MODES[name] if lit else PALE, "white" if lit else "#B0B0B0" if news.stopped else INK)
        self._buttons["release"].paint(AFTER if news.stopped else PALE, "white" if news.stopped else "#B0B0B0")
        stop = "STOPPED" if news.stopped else "EMERGENCY\nSTOP"
        self._buttons["emergency"].paint(PALE_RED if news.stopped else RED, "white", stop)
        self._status.set_text(
            f"{news.ticks} ticks of {1e3 * self._facts.sample_time_s:g} ms, {news.late} late, "
            f"lateness mean {news.mean_ms:.2f} ms, worst {news.worst_ms:.1f} ms, {news.missed} missed"
        )
        self._note.set_text(news.note[:90])
        last = self.strips.last
        if last is not None:
            self._show_reading(*last)
        self.draw_strips()

    def draw_strips(self) -> None:
        """The charts as they are asked for now."""
        if self.strips.draw():
            self._background = None  # the numbers at an axis are part of it

    def _show_reading(self, last: Reading, speed: float) -> None:
        angle = (last.pos + 1) * 360.0 / self._facts.counts_per_rev  # as the lab text has it: 0.5 to 360
        x, y = _on_dial(angle)
        self._needle.set_data([0.5 * x, 0.85 * x], [0.5 * y, 0.85 * y])
        self._angle.set_text(f"{angle:.1f}°")
        way = "1, counting down" if last.direction else "0, counting up"
        self._values.set_text(f"{last.pos}\n{_signed(speed, 0)} deg/s  ({_signed(speed / 6.0, 1)} rpm)\n{way}")

    # ---- painting and asking ------------------------------------------------------------------------------------

    def frame(self) -> None:
        """Paint the moving parts."""
        canvas = self._canvas
        if not self._blit:
            canvas.draw_idle()
        elif self._background is None:
            canvas.draw()
        else:
            canvas.restore_region(self._background)
            self._paint()
            canvas.blit(self.figure.bbox)

    def _on_draw(self, event: Event) -> None:
        """All was drawn but the moving parts: keep it, and put them on top."""
        if self._blit:
            self._background = self._canvas.copy_from_bbox(self.figure.bbox)
            self._paint()

    def _paint(self) -> None:
        for artist in self._moving:
            self.figure.draw_artist(artist)

    def _on_press(self, event: Any) -> None:
        """By place alone: a button must work whatever else matplotlib believes to hold the mouse."""
        for name, button in self._buttons.items():
            if button.axes.bbox.contains(event.x, event.y) and not (event.dblclick and name == "reverse"):
                self._act(name, None)
                return
        if self.strips.press(event):
            self.draw_strips()
        elif self._slider.drag_active:  # pressed where it stood already: that is no change, but it is a wish
            self._act("duty", float(self._slider.val))

    def _on_release(self, event: Any) -> None:
        if self.strips.release(event):
            self.draw_strips()

    def _on_key(self, event: Any) -> None:
        if event.key in KEYS:
            self._act(*KEYS[event.key])


def _on_dial(angle_deg: float) -> tuple[float, float]:
    """Where an angle stands on the dial: 0 at the top, clockwise."""
    return float(np.sin(np.radians(angle_deg))), float(np.cos(np.radians(angle_deg)))


def _signed(value: float, digits: int) -> str:
    """With its sign, as matplotlib's axes write it; zero has none."""
    return f"{value:+.{digits}f}".replace("-", "\u2212") if round(value, digits) else f"{0.0:.{digits}f}"


def _words(news: News) -> str:
    bits = {"drive": "1 0" if news.duty_pct > 0 else "0 1", "brake": "1 1", "standby": "0 0"}[news.mode]
    way = "" if news.mode != "drive" else " forward" if news.duty_pct > 0 else " reverse"
    return f"duty {_signed(news.duty_pct, 0)} %    {news.mode}{way}    C3 C4 = {bits}"
