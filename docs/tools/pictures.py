"""Makes the pictures of the documents from simulated data: ``python docs/tools/pictures.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

from fiohost.bench.connect import connect
from fiohost.circle.close import close_loop
from fiohost.report.circle import confirm_series
from fiohost.report.plots import as_png, plot_series

FOLDER = Path(__file__).resolve().parent.parent / "images"
SEED = 280


def main() -> None:
    with tempfile.TemporaryDirectory() as folder, connect("sim:sealed", seed=SEED) as bench:
        circle = close_loop(bench, Path(folder), say=print)
        FOLDER.mkdir(exist_ok=True)
        (FOLDER / "fresh_record.png").write_bytes(as_png(plot_series(confirm_series(circle)), dpi=100))


if __name__ == "__main__":
    main()
