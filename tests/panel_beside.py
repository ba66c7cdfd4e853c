"""Run as a program: the controls beside the window's picture, pressed. A process of its own, which Tk ends with its
screen. Arguments are what to try: duty, source, loop, charts.
"""

from __future__ import annotations

import sys
import tkinter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fiohost.bench.log import Log
from fiohost.errors import LimitError
from fiohost.panel import link
from fiohost.panel.controls import Controls
from fiohost.panel.side import Side
from fiohost.panel.view import View


class Beside:
    """The controls with the messages that they send and the bench's part played."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Any]] = []
        self.controls = Controls()
        figure = Figure(figsize=(10.8, 6.6))
        FigureCanvasAgg(figure)
        self.view = View(figure, link.Facts("sim", 720, 0.005, 100.0, ""), self.act)
        self.window = tkinter.Tk()
        self.side = Side(self.window, self.view, self.act)
        self.window.update()
        self.time_s = 0.0

    def act(self, name: str, value: Any = None) -> None:
        self.asked.append((name, value))
        if name != "record":
            self.controls.act(name, value)

    def press(self, name: str) -> Any:
        self.asked.clear()
        self.side.buttons[name].invoke()
        self.hear()
        return self.asked[0] if self.asked else None

    def put(self, name: str, text: str, key: str = "<Return>") -> Any:
        """Write it and press a key, as a person would."""
        self.asked.clear()
        self.side.fields[name].set(text)
        entry = self.side.entries[name]
        entry.focus_force()
        self.window.update()
        entry.event_generate(key)
        self.window.update()
        return self.asked[0] if self.asked else None

    def hear(self, seconds: float = 0.2, recording: str = "") -> None:
        """News of so many seconds: the shaft turns at 100 deg/s."""
        times = [self.time_s + 0.02 * i for i in range(1, round(seconds / 0.02) + 1)]
        self.time_s = times[-1]
        readings = [link.Reading(t, 10.0, 1, 0, int(200 * t) % 720, 0, 100.0 * t, 45.0) for t in times]
        duty = self.controls.command.duty_pct
        news = link.News(readings, duty, "drive", self.controls.stopped, 0, "", 0, 0, 0.0, 0.0, 0,
                         self.controls.doing, recording, 7)  # fmt: skip
        self.view.show(news)
        self.side.show(news)


def duty(beside: Beside) -> None:
    assert beside.put("duty", "12,5") == ("duty", 12.5)
    beside.side.fields["duty"].set("-7")
    assert beside.press("set") == ("duty", -7.0)
    assert beside.controls.command.duty_pct == -7.0
    beside.side.fields["duty"].set("fast")
    with pytest.raises(LimitError, match="finite number"):
        beside.side._set_duty()
    assert beside.put("duty", "3", "<Escape>") == ("emergency", None), "wherever one is writing"
    assert beside.controls.stopped


def source(beside: Beside, shape: str) -> None:
    beside.side.fields["source.shape"].set(shape)
    told = {"shape": shape, "amplitude": 30.0, "offset": 0.0, "period_s": 2.0}
    assert beside.press("source") == ("source", told)
    assert beside.controls.doing == "source"
    assert beside.side.buttons["source"]["text"] == "Stop"
    assert beside.put("source.offset", "5") == ("source", told | {"offset": 5.0})
    assert beside.press("source") == ("brake", None)
    assert beside.side.buttons["source"]["text"] == "Start"
    assert beside.put("source.offset", "9") is None, "what does not run begins by its button alone"


def loop(beside: Beside, kind: str) -> None:
    beside.side.fields["loop.kind"].set(kind)
    name, told = beside.press("loop")
    assert (name, told["kind"], told["kp"], told["offset"]) == ("loop", kind.lower(), 1.0, 90.0)
    command, ref = beside.controls.answer(0.0, 0.0)
    assert ref == 90.0
    assert 89.0 < command.duty_pct < 92.0
    _, told = beside.put("loop.kp", "2.5")
    assert told["kp"] == 2.5
    assert beside.controls.answer(0.1, 0.0)[0].duty_pct == 100.0
    beside.side.fields["loop.shape"].set("square")
    _, told = beside.put("loop.amplitude", "20")
    assert (told["shape"], told["amplitude"]) == ("square", 20.0)


def charts(beside: Beside) -> None:
    assert beside.press("record") == ("record", True)
    beside.hear(1.0, recording="panel-1.csv")
    assert beside.side.buttons["record"]["text"] == "Stop recording"
    assert beside.press("record") == ("record", False)
    beside.hear(12.0)
    strips = beside.view.strips
    assert strips.shown_s == pytest.approx((beside.time_s - 10.0, beside.time_s))
    beside.press("pause")
    assert beside.side.buttons["pause"]["text"] == "Go on"
    held = strips.shown_s
    beside.hear(3.0)
    assert strips.shown_s == held
    axes = beside.view.figure.axes[1]
    for at_s, take in ((5.0, strips.press), (7.0, strips.release)):  # a drag over a chart
        assert take(SimpleNamespace(inaxes=axes, xdata=at_s, dblclick=False))
    assert strips.shown_s == pytest.approx((5.0, 7.0))
    beside.press("export")
    log = Log.read("panel_shown.csv")
    assert 99 <= len(log) <= 101
    assert (log.time_s[0], log.time_s[-1]) == pytest.approx((5.0, 7.0), abs=0.021)
    assert np.polyfit(log.time_s, log.output, 1)[0] == pytest.approx(100.0, rel=0.01)
    beside.press("all")
    assert strips.shown_s[0] == pytest.approx(0.02)
    beside.put("span", "5", "<<ComboboxSelected>>")
    assert strips.shown_s == pytest.approx((beside.time_s - 5.0, beside.time_s))
    assert beside.side.buttons["pause"]["text"] == "Pause"


TRIED = {
    "duty": [duty],
    "source": [lambda beside, shape=shape: source(beside, shape) for shape in ("step", "sine", "square")],
    "loop": [lambda beside, kind=kind: loop(beside, kind) for kind in ("P", "PD", "PI", "PID")],
    "charts": [charts],
}

if __name__ == "__main__":
    for one in TRIED[sys.argv[1]]:
        made = Beside()
        one(made)
        made.window.destroy()
    print("done")
