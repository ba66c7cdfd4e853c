"""Beside the picture of the window: duty by number, sources, controllers, record, pause, span, export. Made of Tk."""

from __future__ import annotations

import tkinter as tk
from collections.abc import Callable
from pathlib import Path
from tkinter import ttk
from typing import Any

from fiohost.errors import FiohostError
from fiohost.files import FreeName, write_output
from fiohost.panel.link import News
from fiohost.panel.sources import SHAPES
from fiohost.panel.strips import SPAN_S, SPANS_S
from fiohost.panel.view import View

WIDTH_PX = 250
# Name in the message, label, value at first; choices where it is one.
SOURCE = (("shape", "shape", "sine"), ("amplitude", "amplitude (%)", "30"), ("offset", "offset (%)", "0"),
          ("period_s", "period (s)", "2"))  # fmt: skip
LOOP = (("kind", "controller", "PD"), ("kp", "kp (%/deg)", "1"), ("ki", "ki (%/(deg s))", "0.5"),
        ("kd", "kd (% s/deg)", "0.03"), ("shape", "set point", "hold"), ("offset", "at (deg)", "90"),
        ("amplitude", "amplitude (deg)", "45"), ("period_s", "period (s)", "4"))  # fmt: skip
CHOICES = {"source.shape": SHAPES[1:], "loop.kind": ("P", "PD", "PI", "PID"), "loop.shape": SHAPES}

Act = Callable[..., None]


class Side:
    """A column of controls at the right of *window*. ``show`` takes news; what a person asks goes to *act*."""

    def __init__(self, window: tk.Misc, view: View, act: Act, *, before: tk.Misc | None = None) -> None:
        self._view, self._act, self._window = view, act, window
        self._doing, self._recording = "hand", False
        self.fields: dict[str, tk.StringVar] = {}
        self.entries: dict[str, ttk.Entry] = {}
        self.buttons: dict[str, ttk.Button] = {}
        frame = ttk.Frame(window, padding=8, width=WIDTH_PX)
        place: dict[str, Any] = {"side": "right", "fill": "y"}
        frame.pack(**place | ({"before": before} if before is not None else {}))
        self._notes = {"record": tk.StringVar(), "export": tk.StringVar()}
        self._charts(frame)
        self._duty(frame)
        self._settings(frame, "source", "Duty from a source", SOURCE)
        self._settings(frame, "loop", "Angle under control", LOOP)
        window.winfo_toplevel().bind("<Escape>", lambda event: act("emergency"))  # wherever one is writing

    # ---- made once ------------------------------------------------------------------------------------------------

    def _charts(self, frame: ttk.Frame) -> None:
        box = self._box(frame, "Record and charts")
        self._button(box, "record", "Record", lambda: self._act("record", not self._recording), 0, 0)
        self._button(box, "pause", "Pause", self._pause, 0, 1)
        self._button(box, "all", "All", self._all, 1, 0)
        self._button(box, "export", "Export CSV", self._export, 1, 1)
        self._field(box, "span", "shown (s)", f"{SPAN_S:g}", 2, tuple(f"{s:g}" for s in SPANS_S), self._span)
        for row, note in enumerate(self._notes.values()):
            said = ttk.Label(box, textvariable=note, wraplength=WIDTH_PX - 20, foreground="#6b7480")
            said.grid(row=3 + row, column=0, columnspan=2, sticky="w")

    def _duty(self, frame: ttk.Frame) -> None:
        box = self._box(frame, "Duty by number")
        self._field(box, "duty", "duty (%)", "0", 0, (), self._set_duty)
        self._button(box, "set", "Set", self._set_duty, 1, 1)

    def _settings(self, frame: ttk.Frame, name: str, title: str, fields: tuple[tuple[str, str, str], ...]) -> None:
        box = self._box(frame, title)
        for row, (key, label, first) in enumerate(fields):
            whole = f"{name}.{key}"
            self._field(box, whole, label, first, row, CHOICES.get(whole, ()), lambda: self._changed(name))
        self._button(box, name, "Start", lambda: self._start(name), len(fields), 1)

    def _box(self, frame: ttk.Frame, title: str) -> ttk.LabelFrame:
        box = ttk.LabelFrame(frame, text=title, padding=(6, 2))
        box.pack(fill="x", pady=(0, 6))
        box.columnconfigure((0, 1), weight=1)
        return box

    def _button(
        self, box: ttk.LabelFrame, name: str, label: str, does: Callable[[], None], row: int, column: int
    ) -> None:
        # no focus: the space bar brakes, and must not press a button again
        button = ttk.Button(box, text=label, command=does, takefocus=False, width=12)
        button.grid(row=row, column=column, sticky="ew", padx=1, pady=1)
        self.buttons[name] = button

    def _field(
        self, box: ttk.LabelFrame, name: str, label: str, first: str, row: int, choices: tuple[str, ...],
        changed: Callable[[], None],
    ) -> None:  # fmt: skip
        variable = self.fields[name] = tk.StringVar(value=first)
        ttk.Label(box, text=label).grid(row=row, column=0, sticky="w")
        if choices:
            entry: ttk.Entry = ttk.Combobox(box, textvariable=variable, values=choices, state="readonly", width=9)
            entry.bind("<<ComboboxSelected>>", lambda event: changed())
        else:
            entry = ttk.Entry(box, textvariable=variable, width=10)
            entry.bind("<Return>", lambda event: changed())
            if name != "duty":
                entry.bind("<FocusOut>", lambda event: changed())
        entry.grid(row=row, column=1, sticky="ew", pady=1)
        self.entries[name] = entry

    # ---- what changes ---------------------------------------------------------------------------------------------

    def show(self, news: News) -> None:
        """Take news of the bench."""
        self._doing, self._recording = news.doing, bool(news.recording)
        self.buttons["record"].configure(text="Stop recording" if self._recording else "Record")
        self._notes["record"].set(f"{news.recording}: {news.recorded} rows" if self._recording else "")
        for name in ("source", "loop"):
            self.buttons[name].configure(text="Stop" if news.doing == name else "Start")
        self._paused()

    def _paused(self) -> None:
        self.buttons["pause"].configure(text="Go on" if self._view.strips.paused else "Pause")

    # ---- what is asked --------------------------------------------------------------------------------------------

    def _set_duty(self) -> None:
        self._act("duty", self._number("duty"))

    def _start(self, name: str) -> None:
        if self._doing == name:
            self._act("brake")
        else:
            self._act(name, self._told(name))

    def _changed(self, name: str) -> None:
        """While it runs, a changed number takes effect at once."""
        if self._doing == name:
            self._act(name, self._told(name))

    def _told(self, name: str) -> dict[str, object]:
        return {
            key: self.fields[f"{name}.{key}"].get().lower()
            if f"{name}.{key}" in CHOICES
            else self._number(f"{name}.{key}")
            for key, _, _ in (SOURCE if name == "source" else LOOP)
        }

    def _number(self, name: str) -> float | str:
        """What is written there; what is no number goes as it is, and is refused with a sentence."""
        text = self.fields[name].get().strip().replace(",", ".")
        try:
            return float(text)
        except ValueError:
            return text[:40]

    def _pause(self) -> None:
        self._view.strips.pause(not self._view.strips.paused)
        self._redraw()

    def _all(self) -> None:
        self._view.strips.everything()
        self._redraw()

    def _span(self) -> None:
        self._view.strips.span(float(self.fields["span"].get()))
        self._redraw()

    def _redraw(self) -> None:
        self._view.draw_strips()
        self._paused()

    def _export(self) -> None:
        try:
            path = write_output(FreeName(Path("panel_shown.csv")), self._view.strips.csv())
            self._notes["export"].set(f"{path} written")
        except FiohostError as exc:
            self._notes["export"].set(str(exc))
