"""Makes the pictures of the documents from simulated data: ``python docs/tools/pictures.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from fiohost.bench.connect import connect
from fiohost.bench.deadband import measure_deadband
from fiohost.bench.experiment import Experiment
from fiohost.bench.loop import Tick
from fiohost.bench.signals import Steps
from fiohost.circle.close import close_loop
from fiohost.labs.design import design_lab
from fiohost.labs.identification import identification
from fiohost.labs.precompensation import precompensation
from fiohost.panel.link import READING_S, Facts, News, Reading
from fiohost.panel.view import DPI, SIZE_IN, View
from fiohost.report.circle import confirm_series
from fiohost.report.deadband import save_deadband_plot
from fiohost.report.plots import as_png, plot_series

FOLDER = Path(__file__).resolve().parent.parent / "images"
SEED = 280


def reading(t: Tick) -> Reading:
    return Reading(t.time_s, t.command.duty_pct, t.command.c3, t.command.c4, t.pos, t.direction, t.angle_deg)


def panel() -> None:
    """The panel after twelve seconds by hand: up in steps, then reversed."""
    steps = Steps(times_s=(3.0, 5.0, 7.5), levels=(20.0, 60.0, -35.0), duration_s=12.0)
    ticks: list[Tick] = []
    with connect("sim") as bench:
        bench.run(Experiment("by_hand", (steps,)), progress=ticks.append, progress_every_s=READING_S)
        facts = Facts("sim", bench.counts_per_rev, bench.sample_time_s, 100.0, "session.csv")
        statistics = bench.statistics
    readings = [reading(t) for t in ticks]
    figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    view = View(figure, facts, lambda name, value: None)
    last = ticks[-1].command
    view.show(
        News(
            readings, last.duty_pct, last.mode_name, stopped=False, handled=0, note="", ticks=statistics.ticks,
            late=0, mean_ms=0.0, worst_ms=0.0, missed=0,
        )
    )  # fmt: skip
    canvas.draw()
    Image.fromarray(np.asarray(canvas.buffer_rgba())).save(FOLDER / "panel.png", optimize=True)


def position_labs() -> None:
    """The pictures of the deadband, precompensation, identification and design pages."""
    with connect("sim:sealed", seed=SEED) as bench:
        uneven = measure_deadband(bench, 2, angles=6)
    save_deadband_plot(uneven, "a board with a weight", FOLDER / "lab_deadband.png")
    drawn = {}
    with tempfile.TemporaryDirectory() as name:
        with connect("sim") as bench:
            drawn |= precompensation(bench, Path(name))[0].figures
        with connect("sim") as bench:
            drawn |= identification(bench, Path(name)).figures
        with connect("sim") as bench:
            drawn["design"] = design_lab(bench, Path(name)).figures["design_90_270"]
        for picture, draw in drawn.items():
            draw().savefig(FOLDER / f"lab_{picture}.png", dpi=90)


def main() -> None:
    panel()
    position_labs()
    with tempfile.TemporaryDirectory() as folder, connect("sim:sealed", seed=SEED) as bench:
        circle = close_loop(bench, Path(folder), say=print)
        FOLDER.mkdir(exist_ok=True)
        (FOLDER / "fresh_record.png").write_bytes(as_png(plot_series(confirm_series(circle)), dpi=100))


if __name__ == "__main__":
    main()
