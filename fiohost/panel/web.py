"""The panel in a browser: the same figure, drawn here by matplotlib's WebAgg and sent as pictures over a web socket.

Served on this computer alone unless asked otherwise; other sites' pages cannot reach the socket (Host and Origin are
checked), and of what a browser sends only what the figure needs is taken, within bounds.
"""

from __future__ import annotations

import asyncio
import json
import time
from contextlib import suppress
from importlib.resources import files
from typing import Any

from matplotlib.backends import backend_webagg_core
from matplotlib.figure import Figure

from fiohost.errors import FiohostError
from fiohost.panel.link import Facts, Remote
from fiohost.panel.view import DPI, SIZE_IN, View

try:
    import tornado.httpserver
    import tornado.web
    import tornado.websocket
except ImportError as exc:
    raise FiohostError(f"the panel in a browser needs the package tornado ({exc}): pip install tornado") from exc

webagg: Any = backend_webagg_core  # it has no types

FRAME_S = 0.08
ACK_LIMIT_S = 1.0  # a browser that paints no slower than this gets every frame
PING_S = 2.0  # a browser that answers no ping for so long has gone
MAX_MESSAGE_BYTES = 4000
MAX_BROWSERS = 20
MOUSE = {"button_press", "button_release", "dblclick", "motion_notify", "figure_enter", "figure_leave", "scroll"}
KEYS = {"key_press", "key_release"}
PLAIN = {"draw", "refresh", "send_image_mode"}
BOUNDS = {"x": 1e5, "y": 1e5, "button": 4, "buttons": 31, "step": 100}  # largest size of each number of a mouse event
SIDE_PX = (200, 4000)
RATIOS = (0.5, 4.0)


class Panel:
    """One figure, the browsers that show it, and its frames."""

    def __init__(self, remote: Remote, facts: Facts, away_s: float | None) -> None:
        figure = Figure(figsize=SIZE_IN, dpi=DPI, facecolor="white")
        self.manager = webagg.FigureManagerWebAgg(webagg.FigureCanvasWebAggCore(figure), 1)
        self.manager.canvas.mpl_disconnect(self.manager.key_press_handler_id)
        self.view = View(figure, facts, remote.act)
        self.browsers: dict[Browser, float | None] = {}  # since when each has had a frame that it has not painted
        self._remote, self._away_s = remote, away_s
        self._alone_since_s: float | None = None  # None: somebody is there, or all that is due to that was done

    def joined(self, browser: Browser) -> None:
        self.browsers[browser] = None
        self._alone_since_s = None
        self.manager.add_web_socket(browser)

    def left(self, browser: Browser) -> None:
        if self.browsers.pop(browser, 0) != 0:
            self.manager.remove_web_socket(browser)
        if not self.browsers:
            self._alone_since_s = time.monotonic()

    def frame(self) -> None:
        """Ask for news, show them where somebody looks. Raises EOFError once the bench has ended."""
        now_s = time.monotonic()
        alone_s = self._alone_since_s
        if alone_s is not None and self._away_s is not None and now_s - alone_s >= self._away_s:
            self._alone_since_s = None
            self._remote.act("brake", why=f"no browser for {self._away_s:g} s: braked")
        news = self._remote.news()
        if news is None:
            return
        self.view.show(news, answered=news.handled == self._remote.actions)
        if self.browsers and not any(s is not None and now_s - s < ACK_LIMIT_S for s in self.browsers.values()):
            self.view.frame()


class Browser(tornado.websocket.WebSocketHandler):
    """One browser's socket. Another site's page has another Origin and is refused by tornado."""

    def initialize(self, panel: Panel, hosts: set[str] | None) -> None:
        self.panel, self._hosts = panel, hosts

    def prepare(self) -> None:
        check_host(self, self._hosts)

    def open(self, *args: str, **kwargs: str) -> None:
        if len(self.panel.browsers) >= MAX_BROWSERS:
            self.close(1013, "too many browsers")
        else:
            self.set_nodelay(True)
            self.panel.joined(self)

    def on_close(self) -> None:
        self.panel.left(self)

    def on_message(self, message: str | bytes) -> None:
        event = checked(message)
        if event is None or self not in self.panel.browsers:
            return
        if event["type"] == "ack":
            self.panel.browsers[self] = None
        else:
            self.panel.manager.handle_json(event)

    # what matplotlib calls

    def send_json(self, content: dict[str, Any]) -> None:
        self._send(json.dumps(content), binary=False)

    def send_binary(self, blob: bytes) -> None:
        self.panel.browsers[self] = time.monotonic()
        self._send(blob, binary=True)

    def _send(self, message: str | bytes, *, binary: bool) -> None:
        with suppress(tornado.websocket.WebSocketClosedError):  # on_close comes
            self.write_message(message, binary=binary).add_done_callback(lambda sent: sent.exception())


class Page(tornado.web.RequestHandler):
    """The page and matplotlib's script."""

    def initialize(self, hosts: set[str] | None) -> None:
        self._hosts = hosts

    def prepare(self) -> None:
        check_host(self, self._hosts)

    def get(self, name: str) -> None:
        self.set_header("X-Frame-Options", "DENY")
        self.set_header("Cache-Control", "no-store")
        if name == "mpl.js":
            self.set_header("Content-Type", "application/javascript; charset=utf-8")
            self.write(webagg.FigureManagerWebAgg.get_javascript())
        else:
            self.write(files("fiohost.panel").joinpath("page.html").read_text(encoding="utf-8"))


def check_host(handler: tornado.web.RequestHandler, hosts: set[str] | None) -> None:
    """Refuse a request that came under a name not ours: a page elsewhere may have had its name point here."""
    name = handler.request.host_name.strip("[]")
    if hosts is not None and name not in hosts:
        raise tornado.web.HTTPError(403)


def checked(message: str | bytes) -> dict[str, Any] | None:
    """What the figure may be told of a browser's message; None for anything else."""
    try:
        came = json.loads(message)
    except (ValueError, RecursionError):
        return None
    kind = came.get("type") if isinstance(came, dict) else None
    if not isinstance(kind, str):
        return None
    if kind == "ack" or kind in PLAIN:
        return {"type": kind}
    if kind in MOUSE:
        numbers = {key: _bounded(came.get(key, 0), -most, most) for key, most in BOUNDS.items()}
        if None in numbers.values():
            return None
        whole = {key: int(numbers[key] or 0) for key in ("button", "buttons")}
        return {"type": kind, **numbers, **whole, "modifiers": []}
    if kind in KEYS and isinstance(came.get("key"), str):
        return {"type": kind, "key": came["key"][:40]}
    if kind == "resize":
        sides = {key: _bounded(came.get(key), *SIDE_PX) for key in ("width", "height")}
        return None if None in sides.values() else {"type": kind, **sides}
    if kind == "set_device_pixel_ratio":
        ratio = _bounded(came.get("device_pixel_ratio"), *RATIOS)
        return None if ratio is None else {"type": kind, "device_pixel_ratio": ratio}
    return None


def _bounded(value: object, low: float, high: float) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        return None
    return float(value)


def serve(remote: Remote, facts: Facts, bind: str, port: int, away_s: float | None) -> None:
    """Serve the panel until the bench has ended. Raises FiohostError where the address cannot be had."""
    asyncio.run(_serve(remote, Panel(remote, facts, away_s), bind, port))


async def _serve(remote: Remote, panel: Panel, bind: str, port: int) -> None:
    try:
        sockets = tornado.netutil.bind_sockets(port, bind)
    except OSError as exc:
        raise FiohostError(
            f"cannot serve the panel at {bind}:{port}: {exc.strerror or exc}; --port 0 takes a free port"
        ) from exc
    local = all(s.getsockname()[0] in ("127.0.0.1", "::1") for s in sockets)
    hosts = {"127.0.0.1", "localhost", "::1", bind} if local else None
    pages: list[Any] = [("/socket", Browser, {"panel": panel, "hosts": hosts}), ("/(mpl.js)?", Page, {"hosts": hosts})]
    application = tornado.web.Application(
        pages,
        websocket_ping_interval=PING_S,
        websocket_ping_timeout=PING_S,
        websocket_max_message_size=MAX_MESSAGE_BYTES,
        log_function=lambda handler: None,
    )
    server = tornado.httpserver.HTTPServer(application)
    server.add_sockets(sockets)
    number = sockets[0].getsockname()[1]
    shown = bind if local else "this computer's address"
    remote.ready(f"at http://{f'[{shown}]' if ':' in shown else shown}:{number}/")
    try:
        while True:
            panel.frame()
            await asyncio.sleep(FRAME_S)
    finally:
        server.stop()
        for browser in list(panel.browsers):
            browser.close(1001, "the session has ended")
        await asyncio.sleep(0.1)  # for the farewells to leave
