"""Logs as one page that needs no network: panels that zoom together, with a cursor that reads all curves.

The page carries uPlot (MIT licence, ``vendor/``), some 50 kB, and the data.
"""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from importlib.resources import files as resources
from typing import Any

import numpy as np

from fiohost.report.log_plot import label_of
from fiohost.report.log_series import LogSeries
from fiohost.report.plots import AFTER, BEFORE, GREY, LINE_CYCLE
from fiohost.report.series import Array

MOST_POINTS = 60_000  # of a curve: more would make a heavy page, and no screen has so many
DIGITS = 7

PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{css}
body {{ font: 15px/1.4 system-ui, sans-serif; margin: 1rem; color: #111; background: #fff; }}
h1 {{ font-size: 1.25rem; margin: 0 0 .2rem; }}
p {{ margin: .2rem 0 .8rem; color: #555; }}
.u-legend {{ text-align: left; font-size: 13px; }}
button {{ font: inherit; padding: .2rem .7rem; }}
</style></head><body>
<h1>{title}</h1>
<p>Drag to zoom in time, double click or <button id="all">show all</button>.
Click a name below a panel to hide its curve.</p>
<div id="panels"></div>
<script>{script}</script>
<script>
"use strict";
const panels = {panels};
const sync = uPlot.sync("time"), plots = [], room = document.getElementById("panels");
const read = (u, v) => v == null ? "–" : Number(v.toPrecision(6)).toString();
let zooming = false;
function zoom(u) {{
  if (zooming) return;
  zooming = true;
  const {{min, max}} = u.scales.x;
  for (const p of plots) if (p !== u) p.setScale("x", {{min, max}});
  zooming = false;
}}
function width() {{ return Math.max(320, room.clientWidth); }}
const texts = (u, all) => all.map(v => Number(v.toPrecision(9)).toString()), none = (u, all) => all.map(() => "");
panels.forEach((panel, place) => {{
  const last = place === panels.length - 1;
  const time = last ? {{label: "time (s)", size: 28, labelSize: 18, values: texts}} : {{size: 6, values: none}};
  const options = {{
    width: width(), height: panel.height + (last ? 46 : 6),
    cursor: {{sync: {{key: "time"}}, drag: {{x: true, y: false}}}},
    scales: {{x: {{time: false}}}},
    axes: [time, {{label: panel.label, size: 62, labelSize: 20, space: 20, values: texts}}],
    series: [{{label: "time (s)", value: read}}].concat(panel.curves.map(c => ({{
      label: c.label, stroke: c.colour, width: c.width, dash: c.dash, spanGaps: true,
      paths: c.step ? uPlot.paths.stepped({{align: 1}}) : undefined, points: {{show: false}},
      value: read,
    }}))),
    hooks: {{setScale: [(u, key) => {{ if (key === "x") zoom(u); }}]}},
  }};
  plots.push(new uPlot(options, panel.data, room));
  if (place) plots[place].root.querySelector(".u-legend .u-series").style.display = "none";  // the time is read above
}});
function all() {{
  for (const p of plots) p.setScale("x", {{min: p.data[0][0], max: p.data[0][p.data[0].length - 1]}});
}}
document.getElementById("all").onclick = all;
room.addEventListener("dblclick", all);
window.addEventListener("resize", () => {{ for (const p of plots) p.setSize({{width: width(), height: p.height}}); }});
</script></body></html>
"""


def log_page(series: Sequence[LogSeries], title: str) -> str:
    """The page as text."""
    vendor = resources("fiohost.report") / "vendor"
    panels = json.dumps(_panels(series), allow_nan=False).replace("</", "<\\/")
    return PAGE.format(
        title=html.escape(title),
        css=(vendor / "uPlot.min.css").read_text(encoding="utf-8"),
        script=(vendor / "uPlot.iife.min.js").read_text(encoding="utf-8"),
        panels=panels,
    )


def _panels(series: Sequence[LogSeries]) -> list[dict[str, Any]]:
    several = len(series) > 1
    wanted: dict[str, list[tuple[LogSeries, str, Array, str, dict[str, Any]]]] = {}
    for place, one in enumerate(series):
        colour = LINE_CYCLE[place % len(LINE_CYCLE)] if several else "#000000"
        tag = f"{one.name}: " if several else ""
        top = wanted.setdefault(f"{one.quantity} ({one.unit})", [])
        if one.ref is not None:
            top.append((one, f"{tag}reference", one.ref, GREY, {}))
        top.append((one, f"{tag}measured", one.output, colour, {}))
        if one.simulated is not None:
            model = BEFORE if not several else colour
            top.append((one, f"{tag}{one.model}", one.simulated, model, {"dash": [6, 3]}))
            error = wanted.setdefault(f"error ({one.unit})", [])
            error.append((one, f"{tag}measured - {one.model}", one.output - one.simulated, model, {}))
        if one.speed is not None:
            wanted.setdefault(f"speed ({one.speed_unit})", []).append((one, f"{tag}speed", one.speed, colour, {}))
        duty = wanted.setdefault("duty (%)", [])
        duty.append((one, f"{tag}duty", one.duty_pct, AFTER if not several else colour, {"step": True}))
        for name, values in one.beside.items():
            wanted.setdefault(label_of(name), []).append((one, f"{tag}{label_of(name)}", values, colour, {}))
    return [_panel(label, curves, place) for place, (label, curves) in enumerate(wanted.items())]


def _panel(
    label: str, curves: Sequence[tuple[LogSeries, str, Array, str, dict[str, Any]]], place: int
) -> dict[str, Any]:
    """One panel: curves of different logs on one axis of time, null where a log has no row."""
    kept = [_thinned(one.time_s, values) for one, _, values, _, _ in curves]
    times = np.unique(np.concatenate([t for t, _ in kept]))
    data: list[list[float | None]] = [[_number(t) for t in times]]
    for t, values in kept:
        column: list[float | None] = [None] * len(times)
        for index, value in zip(np.searchsorted(times, t).tolist(), values.tolist(), strict=True):
            column[index] = _number(value)
        data.append(column)
    told = [{"label": name, "colour": colour, "width": 1.3, **more} for _, name, _, colour, more in curves]
    return {"label": label, "height": 260 if place == 0 else 150, "curves": told, "data": data}


def _number(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None


def _thinned(time_s: Array, values: Array) -> tuple[Array, Array]:
    """The least and the greatest of each of MOST_POINTS / 2 pieces."""
    if len(values) <= MOST_POINTS:
        return time_s, values
    edges = np.linspace(0, len(values), MOST_POINTS // 2 + 1).astype(int)[:-1]
    pieces = np.split(np.arange(len(values)), edges[1:])
    picked = np.unique([i for p in pieces for i in (p[np.argmin(values[p])], p[np.argmax(values[p])])])
    return time_s[picked], values[picked]
