"""Makes the pictures of the panel, in a window and in a browser: ``python docs/tools/panel_pictures.py``.

The panel runs as people run it, on a screen without a monitor and in headless Chromium, driven by a source or a
controller.
Needs Xvfb, xdotool, chromium and Python's Tk.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parent.parent.parent
FOLDER = ROOT / "docs" / "images"
sys.path.insert(0, str(ROOT / "tests"))

from desktop import Chromium, Screen, until  # noqa: E402

RUNS_S = 14.0  # that are in the charts
WIDE = (1200, 900)
PICTURE_PX = (1080, 660)
START = (1257, 371)  # the source's button in the window, in pixels from its upper left corner
STANDS_S = 6.0  # after which a window that has come takes the mouse


@contextmanager
def panel(folder: str, environment: dict[str, str], *arguments: str) -> Iterator[Callable[[], str]]:
    """The command; gives what tells where it is."""
    out = Path(folder) / "out.txt"
    with out.open("w") as file:
        command = [sys.executable, "-m", "fiohost", "panel", *arguments]
        process = subprocess.Popen(command, stdout=file, cwd=folder, env={**environment, "PYTHONPATH": str(ROOT)})
    try:
        yield lambda: out.read_text().partition("panel ")[2].partition(";")[0]
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


def in_a_browser(folder: str) -> None:
    """A PD controller follows a square."""
    with (
        panel(folder, dict(os.environ), "--web", "--port", "0", "--away", "never") as where,
        Chromium(Path(folder) / "profile") as browser,
    ):
        address = until(where).removeprefix("at ")
        browser.width(*WIDE)
        browser.open(address)
        until(lambda: (browser.value("window.fiohostPanel ? fiohostPanel.columns[0].length : 0") or 0) > 20)
        browser.put("#l-shape", "square")
        browser.press("#loop")
        browser.press("#record")
        time.sleep(RUNS_S)
        browser.value("window.scrollTo(0, 0)")
        browser.picture(FOLDER / "panel.png")


def in_a_window(folder: str) -> None:
    """A sine of the duty."""
    with Screen() as screen, panel(folder, screen.environment) as where:
        until(where)
        window = screen.window("fiohost panel: sim")
        time.sleep(STANDS_S)
        screen.click(window, START[0] / PICTURE_PX[0], 1.0 - START[1] / PICTURE_PX[1], PICTURE_PX)
        time.sleep(RUNS_S)
        whole = Path(folder) / "screen.png"
        screen.picture(whole)
        wide, high = screen.size(window)
        Image.open(whole).crop((0, 0, wide, high)).save(FOLDER / "panel_window.png", optimize=True)


def main() -> None:
    for make in (in_a_browser, in_a_window):
        with tempfile.TemporaryDirectory() as folder:
            make(folder)


if __name__ == "__main__":
    main()
