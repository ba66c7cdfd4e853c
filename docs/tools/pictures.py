"""Makes the pictures of the documents from simulated data: ``python docs/tools/pictures.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

from fiohost.bench.connect import connect
from fiohost.bench.deadband import measure_deadband
from fiohost.circle.close import close_loop
from fiohost.labs.design import design_lab
from fiohost.labs.identification import identification
from fiohost.labs.precompensation import precompensation
from fiohost.report.circle import confirm_series
from fiohost.report.deadband import plot_deadband
from fiohost.report.pictures import save_figure
from fiohost.report.plots import as_png, plot_series

FOLDER = Path(__file__).resolve().parent.parent / "images"
SEED = 280


def position_labs() -> None:
    """The pictures of the deadband, precompensation, identification and design pages."""
    with connect("sim:sealed", seed=SEED) as bench:
        uneven = measure_deadband(bench, 2, angles=6)
    picture_of_deadband = FOLDER / "lab_deadband.png"
    picture_of_deadband.unlink(missing_ok=True)  # made anew here, where the commands overwrite nothing unasked
    save_figure(plot_deadband(uneven, "a board with a weight"), picture_of_deadband)
    drawn = {}
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(name) / lab for lab in ("precompensation", "identification", "design")]
        for folder in folders:
            folder.mkdir()
        with connect("sim") as bench:
            drawn |= precompensation(bench, folders[0])[0].figures
        with connect("sim") as bench:
            drawn |= identification(bench, folders[1]).figures
        with connect("sim") as bench:
            drawn["design"] = design_lab(bench, folders[2]).figures["design_90_270"]
        for picture, draw in drawn.items():
            draw().savefig(FOLDER / f"lab_{picture}.png", dpi=90)


def main() -> None:
    position_labs()
    with tempfile.TemporaryDirectory() as folder, connect("sim:sealed", seed=SEED) as bench:
        circle = close_loop(bench, Path(folder), say=print)
        FOLDER.mkdir(exist_ok=True)
        (FOLDER / "fresh_record.png").write_bytes(as_png(plot_series(confirm_series(circle)), dpi=100))


if __name__ == "__main__":
    main()
