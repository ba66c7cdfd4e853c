"""Pictures of a diagnosis with matplotlib, drawn off screen (Agg) and in colours that colour-blind people tell apart.

Every function returns a figure; ``as_svg`` and ``as_png`` turn it into text or bytes. This module is imported when the
first picture is drawn, and nowhere else in the report room, since matplotlib is slow to load.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from fiohost.files import make_folder, write_output
from fiohost.report.series import Array, CurvePlot, SeriesPlot
from fiohost.report.words import effect_words, number

# Okabe and Ito's palette, told apart in all common kinds of colour blindness and in print by line style
MEASURED, BEFORE, AFTER, FLOOR, GREY = "#000000", "#D55E00", "#0072B2", "#009E73", "#7A7A7A"
LINE_CYCLE = (AFTER, BEFORE, FLOOR, "#CC79A7", "#56B4E9", "#E69F00")
ROLES = {"train": "training", "holdout": "held out", "confirm": "fresh record, never used before"}
MAX_POINTS = 3000
PIECES = 250  # of a band over time
STYLE: dict[Any, Any] = {
    "text.parse_math": False,  # a name with dollar signs is no formula
    "font.size": 10.0,
    "axes.titlesize": 11.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E4E4E4",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "figure.facecolor": "white",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
}


@matplotlib.rc_context(STYLE)
def plot_series(series: SeriesPlot) -> Figure:
    """Measured output against the simulated ones, both residuals on their own scales, and the duty below."""
    residuals = [(name, y) for name, y in (("before", series.before), ("after", series.after)) if y is not None]
    heights = [3.0] + [1.25] * len(residuals) + ([0.9] if series.duty_pct is not None else [])
    figure, rows = _figure(9.0, 1.1 + 1.1 * sum(heights), heights)
    pick = thin(series.time_s, series.measured)
    time_s = series.time_s[pick]

    top = rows[0]
    top.plot(time_s, series.measured[pick], color=MEASURED, linewidth=2.4, alpha=0.45, label="measured")
    for name, y in residuals:
        top.plot(time_s, y[pick], **_line(name), label=f"simulated {name}")
    top.set_ylabel(f"{_quantity(series.unit)} ({series.unit})")
    top.set_title(f"{series.title}: {ROLES.get(series.role, series.role)}")
    top.legend(loc="upper left", bbox_to_anchor=(0.0, -0.02), ncols=3, borderaxespad=0.1)

    for axes, (name, y) in zip(rows[1:], residuals, strict=False):
        error = series.measured - y
        colour, dense = _line(name)["color"], len(error) > 2 * PIECES
        axes.axhline(0.0, color=GREY, linewidth=0.8)
        if np.isfinite(series.floor_rms) and series.floor_rms > 0:
            axes.axhspan(-series.floor_rms, series.floor_rms, color=FLOOR, alpha=0.25, linewidth=0)
            for edge in (-series.floor_rms, series.floor_rms):
                axes.axhline(edge, color=FLOOR, linewidth=1.3, linestyle=(0, (4, 2)), zorder=4)
        if dense:  # drawn sample by sample it would be a solid block
            at_s, least, mean, most = band(series.time_s, error)
            axes.fill_between(at_s, least, most, color=colour, alpha=0.28, linewidth=0)
            axes.plot(at_s, mean, color=colour, linewidth=1.1)
        else:
            axes.plot(series.time_s, error, color=colour, linewidth=0.9)
        axes.set_ylabel(f"error {name}\n({series.unit})")
        rms = float(np.sqrt(np.mean(error**2))) if error.size else float("nan")
        floor = f", floor {series.floor_rms:.3g} {series.unit} (green)" if np.isfinite(series.floor_rms) else ""
        drawn = "; line: mean, band: least to greatest" if dense else ""
        note = f"{name}: {rms:.3g} {series.unit} rms{floor}{drawn}"
        axes.set_title(note, fontsize=9, fontweight="normal", color="#333333", pad=3)
    if series.duty_pct is not None:
        axes = rows[-1]
        axes.step(series.time_s, series.duty_pct, where="post", color=GREY, linewidth=1.0)
        axes.set_ylabel("duty (%)")
        low, high = float(np.min(series.duty_pct, initial=0.0)), float(np.max(series.duty_pct, initial=0.0))
        room = 0.1 * (high - low) or 1.0
        axes.set_ylim(low - room, high + room)
    for axes in rows[:-1]:
        axes.tick_params(labelbottom=False)
    rows[-1].set_xlabel("time (s)")
    if len(time_s) > 1:
        rows[-1].set_xlim(series.time_s[0], series.time_s[-1])
    figure.align_ylabels(rows)
    return figure


@matplotlib.rc_context(STYLE)
def plot_residual_bars(logs: Sequence[Mapping[str, Any]], unit: str) -> Figure:
    """Error of every log before and after beside its floor, whole run and 1 s windows, on a logarithmic scale."""
    names = [f"{Path(str(log.get('file', '?'))).name}  [{_short_role(log)}]" for log in logs]
    figure, (left, right) = _columns(9.0, 1.7 + 0.32 * len(logs))
    y = np.arange(len(logs))[::-1]
    for axes, key, title in ((left, "free_run_rms", "whole run"), (right, "window_rms", "1 s windows")):
        before, after, floor = (_figures(logs, stage, key) for stage in ("before", "after", "floor"))
        axes.hlines(y, np.fmin(before, after), np.fmax(before, after), color="#C8C8C8", linewidth=2.5, zorder=1)
        axes.scatter(before, y, color=BEFORE, marker="o", s=34, label="before", zorder=3)
        axes.scatter(after, y, color=AFTER, marker="D", s=30, label="after", zorder=4)
        axes.scatter(floor, y, color=FLOOR, marker="|", s=150, linewidths=2.4, label="floor", zorder=2)
        _log_axis(axes, np.concatenate([before, after, floor]))
        axes.set_xlabel(f"rms error ({unit})")
        axes.set_title(title)
        axes.set_ylim(-0.7, len(logs) - 0.3)
    left.set_yticks(y, names)
    right.tick_params(labelleft=False)
    right.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


@matplotlib.rc_context(STYLE)
def plot_candidates(candidates: Sequence[Mapping[str, Any]], chosen: Sequence[str], most: int = 16) -> Figure:
    """How much of the residual each candidate takes, the chosen ones marked."""
    ranked = sorted(candidates, key=lambda c: -_float(c.get("score")))[:most]
    figure, (axes,) = _figure(9.0, 1.3 + 0.3 * max(len(ranked), 1), [1.0])
    y = np.arange(len(ranked))[::-1]
    scores = 100.0 * np.array([_float(c.get("score")) for c in ranked])
    taken = [str(c.get("effect")) in chosen for c in ranked]
    bars = axes.barh(y, scores, color=[AFTER if t else "#C4CDD5" for t in taken], height=0.72)
    for bar, mark in zip(bars, taken, strict=True):
        if mark:
            bar.set_hatch("//")
            bar.set_edgecolor("white")
    axes.set_yticks(y, [effect_words(str(c.get("effect"))) for c in ranked])
    for position, score, mark in zip(y, scores, taken, strict=True):
        axes.annotate(
            f" {number(score, 2)} %" + ("  chosen" if mark else ""),
            (max(score, 0.0), position),
            va="center",
            fontsize=9,
        )
    axes.set_xlim(0.0, 1.2 * max(float(scores.max(initial=0.0)), 0.1))  # a negative score takes nothing: no bar
    axes.set_xlabel("share of the residual that the candidate takes (%)")
    axes.set_title("Candidates")
    axes.grid(axis="y", visible=False)
    return figure


@matplotlib.rc_context(STYLE)
def plot_answers(questions: Sequence[tuple[str, Mapping[str, Any]]], floor: float | None, unit: str) -> Figure:
    """Window error under each answer to what a command means, the best one marked, beside the floor."""
    rows = [
        (f"{name}: {answer}", _float(error), answer == question.get("best"))
        for name, question in questions
        if len(question.get("window_rms") or {}) > 1
        for answer, error in question["window_rms"].items()
    ]
    figure, (axes,) = _figure(9.0, 1.3 + 0.32 * max(len(rows), 1), [1.0])
    y = np.arange(len(rows))[::-1]
    errors = np.array([error for _, error, _ in rows])
    axes.scatter(errors, y, color=[AFTER if best else GREY for _, _, best in rows], marker="D", s=34, zorder=3)
    if floor:
        axes.axvline(floor, color=FLOOR, linewidth=1.6, linestyle=(0, (4, 2)), label="floor")
        axes.legend(loc="best")
    axes.set_yticks(y, [name for name, _, _ in rows])
    _log_axis(axes, np.concatenate([errors, [floor or np.nan]]))
    axes.set_xlabel(f"error in 1 s windows ({unit})")
    axes.set_title("What a command means: the declared model under each answer")
    return figure


@matplotlib.rc_context(STYLE)
def plot_separations(separation: Mapping[str, Any], chosen: str | None) -> Figure:
    """By how many times the floor rivals would differ in every experiment of the menu, the chosen one marked."""
    rivals = [str(r) for r in separation.get("rivals") or []]
    experiments = sorted(
        separation.get("experiments") or [], key=lambda e: min(map(_float, e["over_floor"].values()), default=0.0)
    )
    figure, (axes,) = _figure(9.0, 1.4 + 0.3 * max(len(experiments), 1), [1.0])
    y = np.arange(len(experiments))
    for index, rival in enumerate(rivals):
        values = np.array([_float(e["over_floor"].get(rival)) for e in experiments])
        color = LINE_CYCLE[index % len(LINE_CYCLE)]
        axes.scatter(values, y, s=40, marker="osD^v"[index % 5], color=color, label=effect_words(rival), zorder=3)
    axes.axvline(_float(separation.get("separates_from")), color=FLOOR, linestyle=(0, (4, 2)), label="tells apart from")
    names = [str(e.get("experiment")) for e in experiments]
    axes.set_yticks(y, [f"{n} (chosen)" if n == chosen else n for n in names])
    axes.set_xlim(left=0.0)
    axes.set_xlabel("predicted difference, in times the floor")
    axes.set_title("What each experiment would tell apart")
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


@matplotlib.rc_context(STYLE)
def plot_curve(curve: CurvePlot) -> Figure:
    """A curve with its band and points."""
    figure, (axes,) = _figure(7.5, 4.2, [1.0])
    if curve.band is not None:
        axes.fill_between(curve.x, *curve.band, color=AFTER, alpha=0.18, linewidth=0, label=curve.band_label)
    styles = ("-", "--", "-.", ":")
    for index, (label, y) in enumerate(curve.lines.items()):
        color = LINE_CYCLE[index % len(LINE_CYCLE)]
        axes.plot(curve.x, y, color=color, linestyle=styles[index % 4], linewidth=1.7, label=label)
    for index, (label, (x, y)) in enumerate(curve.points.items()):
        axes.scatter(x, y, s=26, marker="osD^v"[index % 5], color=MEASURED, alpha=0.7, label=label, zorder=3)
    axes.set_xlabel(curve.x_label)
    axes.set_ylabel(curve.y_label)
    axes.set_title(curve.title)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best")
    return figure


@matplotlib.rc_context(STYLE)
def as_svg(figure: Figure) -> str:
    """The figure as an ``<svg>`` element to be put into a page: no prolog, no name spaces, nothing external."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", text)
    used = set(re.findall(r"#([\w.-]+)", text))  # several pictures share a page: keep only ids that are referred to
    return re.sub(r'\s+id="([^"]*)"', lambda match: match[0] if match[1] in used else "", text)


def as_png(figure: Figure, dpi: int = 130) -> bytes:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def save_plots(
    folder: Path, series: Sequence[SeriesPlot], diagnosis: Mapping[str, Any], curves: Sequence[CurvePlot] = ()
) -> list[Path]:
    """Write every picture of a diagnosis as PNG into *folder* (made where absent); gives the files. Raises LogError."""
    pictures: list[tuple[str, Figure]] = []
    logs = diagnosis.get("logs") or []
    candidates = diagnosis.get("candidates") or []
    if logs:
        pictures.append(("errors_per_log", plot_residual_bars(logs, str(diagnosis.get("output_unit", "")))))
    if candidates:
        chosen = [str(step.get("effect")) for step in diagnosis.get("steps") or []]
        pictures.append(("candidates", plot_candidates(candidates, chosen)))
    if diagnosis.get("separation"):
        upcoming = (diagnosis.get("next_experiment") or {}).get("experiment")
        pictures.append(("next_experiment", plot_separations(diagnosis["separation"], upcoming)))
    pictures += [(f"log_{i:02d}_{s.title}", plot_series(s)) for i, s in enumerate(series, start=1)]
    pictures += [(f"curve_{i:02d}_{c.title.partition(':')[0]}", plot_curve(c)) for i, c in enumerate(curves, start=1)]
    written = []
    make_folder(folder)
    for name, figure in pictures:
        path = folder / (re.sub(r"[^A-Za-z0-9_.-]+", "_", name)[:80] + ".png")
        written.append(write_output(path, as_png(figure)))
    return written


def _figure(width_in: float, height_in: float, heights: Sequence[float]) -> tuple[Figure, list[Axes]]:
    """Panels above each other that share the x axis."""
    figure = canvas(width_in, height_in)
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": list(heights)})
    return figure, list(axes[:, 0])


def _columns(width_in: float, height_in: float) -> tuple[Figure, tuple[Axes, Axes]]:
    """Two panels side by side that share the y axis."""
    figure = canvas(width_in, height_in)
    left, right = figure.subplots(1, 2, sharey=True)
    return figure, (left, right)


def canvas(width_in: float, height_in: float) -> Figure:
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _line(name: str) -> dict[str, Any]:
    if name == "before":
        return {"color": BEFORE, "linestyle": (0, (5, 2)), "linewidth": 1.5}
    return {"color": AFTER, "linestyle": "-", "linewidth": 1.3}


def _log_axis(axes: Axes, values: Array) -> None:
    positive = values[np.isfinite(values) & (values > 0)]
    if positive.size:
        axes.set_xscale("log")
        low, high = positive.min() / 1.6, positive.max() * 1.6
        low = min(low, high / 10.0)
        axes.set_xlim(low, high)
        few = high / low < 300.0
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,), numticks=20))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())


def band(time_s: Array, values: Array, pieces: int = PIECES) -> tuple[Array, Array, Array, Array]:
    """Times, least, mean and greatest of pieces of a series: a long series as a band that stays readable."""
    parts = np.array_split(np.arange(len(values)), min(pieces, len(values)))
    low, mean, high = (np.array([f(values[p]) for p in parts]) for f in (np.min, np.mean, np.max))
    return np.array([time_s[p].mean() for p in parts]), low, mean, high


def thin(time_s: Array, values: Array) -> Array | Any:
    """Indices of the least and greatest sample of each of MAX_POINTS/2 pieces: peaks survive, files stay small."""
    n = len(time_s)
    if n <= MAX_POINTS:
        return np.arange(n)
    pieces = np.array_split(np.arange(n), MAX_POINTS // 2)
    extremes = {int(i) for p in pieces for i in (p[np.argmin(values[p])], p[np.argmax(values[p])])}
    return np.array(sorted(extremes | {0, n - 1}))


def _figures(logs: Sequence[Mapping[str, Any]], stage: str, key: str) -> Array:
    return np.array([_float((log.get(stage) or {}).get(key)) or np.nan for log in logs])


def _float(value: Any) -> float:
    return float(value) if isinstance(value, (int, float)) and np.isfinite(value) else 0.0


def _quantity(unit: str) -> str:
    return {"deg": "angle", "rad": "angle", "deg/s": "speed", "m/s": "speed", "m": "position", "mm": "position"}.get(
        unit, "output"
    )


def _short_role(log: Mapping[str, Any]) -> str:
    return {"train": "training", "holdout": "held out"}.get(str(log.get("role")), str(log.get("role")))
