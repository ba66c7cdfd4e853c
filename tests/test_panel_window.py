"""The panel in a window: the mouse drives it, and the controls beside the picture ask what they say."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from boards import HANG_S
from desktop import Screen, needed
from panel_runs import Run, running
from places import PACKAGES
from test_cli_drive import FIOHOST

from fiohost.bench.log import Log
from fiohost.panel import link

SLIDER_Y, BUTTONS_Y, STOP = 0.175, 0.08, (0.86, 0.13)
PICTURE_PX, RECORD = (1080, 660), (1.065, 0.935)
BRAKE_BUTTON_X, RELEASE_BUTTON_X = 0.11, 0.63


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(PACKAGES))


def slider_x(duty_pct: float) -> float:
    return 0.04 + 0.67 * (duty_pct + 100.0) / 200.0


def click_until(run: Run, what: Callable[[], bool], *clicks: Callable[[], None]) -> None:
    """Click until that comes of it: a window that is not drawn yet takes no mouse."""
    again = 0.0

    def asked() -> bool:
        nonlocal again
        if what():
            return True
        if time.monotonic() >= again:
            for click in clicks:
                click()
            again = time.monotonic() + 10.0
        return False

    run.until(asked)


def drive_by_hand(run: Run, click: Callable[[float, float], None]) -> None:
    """Slider, brake, emergency stop and its release, by the mouse."""

    def pressed(what: Callable[[], bool], *places: tuple[float, float]) -> None:
        click_until(run, what, *(partial(click, *place) for place in places))

    run.until(run.braked)
    pressed(lambda: run.drives(50.0), (slider_x(50.0), SLIDER_Y))
    pos = run.last()[3]
    run.until(lambda: run.last()[3] != pos)
    pressed(run.braked, (BRAKE_BUTTON_X, BUTTONS_Y))
    pressed(lambda: run.drives(50.0), (slider_x(50.0), SLIDER_Y))  # to where the slider may not have left yet
    pressed(lambda: run.drives(-80.0), (slider_x(-80.0), SLIDER_Y))
    pressed(run.braked, STOP)
    click(slider_x(30.0), SLIDER_Y)  # not obeyed
    pressed(lambda: not run.braked(), (RELEASE_BUTTON_X, BUTTONS_Y), (slider_x(-30.0), SLIDER_Y))
    assert run.drives(-30.0)


def test_in_a_window_the_mouse_drives_brakes_and_stops_and_closing_it_brakes() -> None:
    needed("Xvfb", "xdotool")
    with Screen() as screen, running(environment=screen.environment) as run:
        assert run.where() == "in a window"
        window = screen.window("fiohost panel: sim")
        drive_by_hand(run, lambda x, y: screen.click(window, x, y, PICTURE_PX))
        # the record button, at the right of the picture; pressed once more it would end the record
        click_until(run, lambda: any(Path.cwd().glob("panel-*.csv")), lambda: screen.click(window, *RECORD, PICTURE_PX))
        screen.close(window)
        code, _, log = run.ended()
        assert (code, log.metadata["ending"]) == (0, "complete")
        assert log.duty_pct[-1] == pytest.approx(-30.0, abs=2.0)
    (recorded,) = Path.cwd().glob("panel-*.csv")
    assert Log.read(recorded).metadata["ending"] == "complete"


def test_where_no_window_can_be_opened_that_is_said_and_the_browser_named() -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND")}
    done = subprocess.run([*FIOHOST, "panel"], env=environment, capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1
    assert "no window can be opened" in done.stderr
    assert "--web" in done.stderr


def test_a_picture_that_cannot_be_drawn_ends_the_window_instead_of_freezing_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import matplotlib.pyplot as plt

    from fiohost.panel import window

    class Timer:
        def __init__(self) -> None:
            self.callback: Callable[[], None] = lambda: None

        def add_callback(self, callback: Callable[[], None]) -> None:
            self.callback = callback

        def start(self) -> None:
            pass

        stop = start

    timer, said = Timer(), []

    class Bench:
        actions = 0

        def news(self) -> Any:
            raise ZeroDivisionError

        def ready(self, where: str) -> None:
            said.append(where)

        def closed(self) -> None:
            said.append("closed")

        def act(self, name: str, value: float | None) -> None:
            pass

    plt.switch_backend("agg")
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    monkeypatch.setattr(FigureCanvasAgg, "required_interactive_framework", "tk")
    monkeypatch.setattr(FigureCanvasAgg, "new_timer", lambda self, interval: timer)
    monkeypatch.setattr(plt, "show", lambda: timer.callback())
    with pytest.raises(ZeroDivisionError):
        window.show(Bench(), link.Facts("sim", 720, 0.005, 100.0, ""))  # type: ignore[arg-type]
    assert said == ["in a window"]
    assert not plt.get_fignums()


@pytest.mark.long
@pytest.mark.parametrize("what", ["duty", "source", "loop", "charts"])
def test_the_controls_beside_the_picture_ask_what_they_say(what: str) -> None:
    needed("Xvfb", "xdotool")
    script = Path(__file__).with_name("panel_beside.py")
    with Screen() as screen:
        words = [sys.executable, str(script), what]
        done = subprocess.run(words, env=screen.environment, capture_output=True, text=True, timeout=HANG_S)
    assert done.stdout == "done\n", done.stderr[-2000:]
