"""Moving pictures of a run as GIF: the motor's disc and pointer, or the arm that lets its payload go, from above."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fiohost.files import write_output
from fiohost.report.plots import AFTER, BEFORE, FLOOR, GREY, STYLE

FRAMES_PER_S = 25
MOST_S = 8.0
DPI = 75


@dataclass(frozen=True)
class Fall:
    """A payload that is let go: when, where it lands (m from the pivot), and when."""

    at_s: float
    lands_m: tuple[float, float]
    lands_s: float


@matplotlib.rc_context(STYLE)
def animate_motor(
    path: Path, time_s: np.ndarray, angle_deg: np.ndarray, ref_deg: np.ndarray | None, title: str
) -> None:
    """The shaft's disc with its pointer (and the reference's), beside angle against time. Raises FiohostError."""
    figure, dial, plot = _stage(title)
    dial.add_patch(matplotlib.patches.Circle((0, 0), 1.0, fill=False, color=GREY, linewidth=2))
    _square(dial, 1.25)
    (asked,) = dial.plot([], [], color=BEFORE, linestyle="--", linewidth=2, label="reference")
    (pointer,) = dial.plot([], [], color=AFTER, linewidth=4, solid_capstyle="round", label="shaft")
    _sweep(plot, time_s, angle_deg, ref_deg)
    marker = plot.axvline(0.0, color=GREY)
    said = dial.text(0.0, 1.0, "", transform=dial.transAxes, va="bottom")
    dial.legend(loc="lower center", bbox_to_anchor=(0.5, -0.2), ncols=2)

    def draw(k: int) -> None:
        pointer.set_data(*_ray(angle_deg[k]))
        if ref_deg is not None:
            asked.set_data(*_ray(ref_deg[k]))
        marker.set_xdata([time_s[k]] * 2)
        said.set_text(f"{time_s[k]:.2f} s, {angle_deg[k]:.1f} deg")

    _save(path, figure, time_s, (asked, pointer, marker, said), draw)


@matplotlib.rc_context(STYLE)
def animate_arm(
    path: Path, time_s: np.ndarray, angle_deg: np.ndarray, arm_m: float, cup_deg: float, cup_radius_m: float,
    fall: Fall | None, title: str,
) -> None:  # fmt: skip
    """The arm from above with its payload, and the cup. Raises FiohostError."""
    figure, view, plot = _stage(title)
    _square(view, 1.45 * arm_m)
    cup = arm_m * np.array(_unit(cup_deg))
    view.add_patch(matplotlib.patches.Circle((cup[0], cup[1]), cup_radius_m, fill=False, color=FLOOR, linewidth=2.5))
    view.plot([0.0], [0.0], marker="o", markersize=12, color=GREY)
    (arm,) = view.plot([], [], color=AFTER, linewidth=5, solid_capstyle="round", label="arm")
    (load,) = view.plot([], [], color=BEFORE, marker="o", markersize=9, linestyle="none", label="payload")
    view.plot([], [], color=FLOOR, marker="o", fillstyle="none", linestyle="none", label="cup")
    view.legend(loc="lower center", bbox_to_anchor=(0.5, -0.2), ncols=3)
    _sweep(plot, time_s, angle_deg, np.full(len(time_s), cup_deg))
    marker = plot.axvline(0.0, color=GREY)
    said = view.text(0.0, 1.0, "", transform=view.transAxes, va="bottom")

    def draw(k: int) -> None:
        tip = arm_m * np.array(_unit(angle_deg[k]))
        arm.set_data([0.0, tip[0]], [0.0, tip[1]])
        at = tip
        if fall is not None and time_s[k] >= fall.at_s:
            first = int(np.searchsorted(time_s, fall.at_s))
            begin = arm_m * np.array(_unit(angle_deg[min(first, len(angle_deg) - 1)]))
            share = min((time_s[k] - fall.at_s) / max(fall.lands_s - fall.at_s, 1e-6), 1.0)
            at = begin + share * (np.array(fall.lands_m) - begin)
        load.set_data([at[0]], [at[1]])
        marker.set_xdata([time_s[k]] * 2)
        said.set_text(f"{time_s[k]:.2f} s, {angle_deg[k]:.1f} deg")

    _save(path, figure, time_s, (arm, load, marker, said), draw)


def _stage(title: str) -> tuple[Figure, Any, Any]:
    figure = Figure(figsize=(8.4, 3.9))
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    figure.subplots_adjust(left=0.03, right=0.98, bottom=0.16, top=0.86, wspace=0.25)
    figure.suptitle(title, fontsize=11, x=0.01, ha="left")
    return figure, left, right


def _square(axes: Any, half: float) -> None:
    axes.set_aspect("equal")
    axes.set_xlim(-half, half)
    axes.set_ylim(-half, half)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _sweep(axes: Any, time_s: np.ndarray, angle_deg: np.ndarray, ref_deg: np.ndarray | None) -> None:
    if ref_deg is not None:
        axes.plot(time_s, ref_deg, color=BEFORE, linestyle="--", linewidth=1.2, label="reference")
    axes.plot(time_s, angle_deg, color=AFTER, label="angle")
    axes.set_xlabel("time (s)")
    axes.set_ylabel("angle (deg)")
    axes.legend(loc="lower right")


def _unit(angle_deg: float) -> tuple[float, float]:
    """Where an angle points, 0 up and positive to the right."""
    turn = float(np.radians(angle_deg))
    return float(np.sin(turn)), float(np.cos(turn))


def _ray(angle_deg: float) -> tuple[list[float], list[float]]:
    x, y = _unit(angle_deg)
    return [0.0, x], [0.0, y]


def _save(path: Path, figure: Figure, time_s: np.ndarray, moving: Sequence[Any], draw: Callable[[int], None]) -> None:
    """Draw what stands still once, what moves on top of it for each frame."""
    from PIL import Image

    figure.set_dpi(DPI)
    canvas: Any = figure.canvas
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)
    frames = []
    end = min(float(time_s[-1]), MOST_S)
    for k in np.searchsorted(time_s, np.arange(0.0, end, 1.0 / FRAMES_PER_S)).tolist():
        canvas.restore_region(still)
        draw(min(k, len(time_s) - 1))
        for artist in moving:
            artist.axes.draw_artist(artist)
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").quantize(64))
    drawn = io.BytesIO()
    frames[0].save(drawn, "GIF", save_all=True, append_images=frames[1:], duration=1000 // FRAMES_PER_S, loop=0)
    write_output(path, drawn.getvalue())
