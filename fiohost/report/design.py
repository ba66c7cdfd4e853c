"""Designed loops as a picture: the responses in simulation, and where there are some, those measured on a target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure

from fiohost.control.design import Design
from fiohost.control.specification import Specification, simulate_step
from fiohost.report.panels import Curve, Panel, plot_panels


@dataclass(frozen=True)
class Square:
    """Angle and duty of one square wave: pairs (time in s, values) of what is asked for, simulated and measured."""

    title: str
    reference: tuple[Any, Any]
    angles: Sequence[tuple[str, Any, Any]]
    duties: Sequence[tuple[str, Any, Any]]


def plot_design(found: Design, title: str) -> Figure:
    """Each step forward on the model, angle on the left and duty on the right."""
    from fiohost.control.closed_loop import Plant

    plant = Plant.of(found.model)
    loop = found.settings.loop(found.sample_time_s, found.delay_s, found.quantum_deg)
    squares = []
    for size in sorted({abs(one.step_deg) for one in found.found}):
        run = simulate_step(plant, loop, size, found.duration_s)
        angle, duty = ("simulated", run.time_s, run.angle_deg), ("simulated", run.time_s, run.duty_pct)
        squares.append(Square(f"{size:g} deg", (run.time_s, run.ref_deg), [angle], [duty]))
    return plot_squares(squares, title, found.asked)


def plot_squares(squares: Sequence[Square], title: str, asked: Specification | None = None) -> Figure:
    """One row a square: angle on the left, duty on the right; dashed is simulated, drawn is measured."""
    panels = []
    for square in squares:
        reference = Curve(*square.reference, "reference", -1, "reference")
        angles = [reference, *_curves(square.angles)]
        panels += [Panel(angles, "angle (deg)", title=square.title), Panel(_curves(square.duties), "duty (%)")]
    if asked is not None:
        title += (
            f" (asked for: overshoot < {asked.overshoot_pct:g} %, settling < {asked.settling_s:g} s, "
            f"error < {asked.sse_deg:g} deg)"
        )
    return plot_panels(panels, title, columns=2, panel_height=2.6)


def _curves(series: Sequence[tuple[str, Any, Any]]) -> list[Curve]:
    return [
        Curve(times, values, label, i, "model" if label.startswith("simulated") else "target")
        for i, (label, times, values) in enumerate(series)
    ]
