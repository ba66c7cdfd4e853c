"""The panel in a window: a picture on whatever interactive backend of matplotlib there is, controls beside it on Tk."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib

from fiohost.errors import FiohostError
from fiohost.panel.link import Facts, Remote
from fiohost.panel.view import DPI, SIZE_IN, View

if TYPE_CHECKING:
    from fiohost.panel.side import Side

FRAME_MS = 80


def show(remote: Remote, facts: Facts) -> None:
    """Open the window and stay until it is closed or the bench has ended. Raises FiohostError without a backend."""
    matplotlib.rcParams["toolbar"] = "None"
    import matplotlib.pyplot as plt

    cause = ""
    try:
        figure = plt.figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
    except Exception as exc:  # a display that refuses, a toolkit that is broken: each has an error of its own
        cause = f" ({' '.join(str(exc).split())[:120]})"
        figure = None
    if figure is None or figure.canvas.required_interactive_framework is None:
        raise FiohostError(
            f"no window can be opened here{cause}: there is no display, or Python lacks Tk (Debian: apt install "
            "python3-tk); fiohost panel --web shows the same panel in a browser"
        )
    manager: Any = figure.canvas.manager
    figure.canvas.mpl_disconnect(manager.key_press_handler_id)  # its own keys: q, s and others mean something else
    manager.set_window_title(f"fiohost panel: {facts.target}")
    view = View(figure, facts, remote.act)
    side = _side(manager, view, remote)
    ended: list[Exception] = []

    def frame() -> None:
        if not plt.fignum_exists(manager.num):  # a person has closed it, and the toolkit has not come to that yet
            return
        try:
            news = remote.news()
            if news is not None:
                view.show(news, answered=news.handled == remote.actions)
                if side is not None:
                    side.show(news)
                view.frame()
        except Exception as exc:  # a toolkit would print it and go on, with a panel that shows nothing
            ended.append(exc)
            plt.close(figure)

    timer = figure.canvas.new_timer(interval=FRAME_MS)
    timer.add_callback(frame)
    remote.ready("in a window")
    timer.start()
    plt.show()
    timer.stop()
    if ended:
        raise ended[0]
    remote.closed()


def _side(manager: Any, view: View, remote: Remote) -> Side | None:
    """The controls beside the picture, where the window is one of Tk: another toolkit has the picture alone."""
    window: Any = getattr(manager, "window", None)
    if not hasattr(window, "tk"):
        return None
    from fiohost.panel.side import Side

    return Side(window, view, remote.act, before=manager.canvas.get_tk_widget())
