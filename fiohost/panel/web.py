"""The panel in a browser: the same figure, drawn here by matplotlib's WebAgg and sent as pictures over a web socket.

Who drives is watched by the pictures themselves: a browser that does not say that it has painted one, for as long as
``--away`` allows, is taken for gone and the motor is braked. One browser drives, the first; others look on. The address
has a token, names that are not ours are refused (Host and Origin are checked, on every address), and of what a browser
sends only what the figure needs is taken, within bounds of size and rate.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import json
import logging
import secrets
import socket
import time
from contextlib import suppress
from importlib.resources import files
from typing import Any

from matplotlib.backends import backend_webagg_core
from matplotlib.figure import Figure

from fiohost.errors import FiohostError
from fiohost.files import shown
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
PING_S = 10.0  # a browser that answers no ping for so long has gone; who drives is watched by frames
MAX_MESSAGE_BYTES = 4000
MAX_HEADER_BYTES = 16_000
MAX_BROWSERS = 20
RATE = 200.0  # messages a second, of which a mouse in motion sends half ...
BURST = 400.0  # ... and so many at once; more are not heard
logger = logging.getLogger("fiohost.panel")
MOUSE = {"button_press", "button_release", "dblclick", "motion_notify", "figure_enter", "figure_leave", "scroll"}
KEYS = {"key_press", "key_release"}
ACTS = MOUSE | KEYS  # by which one drives
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
        # since when each has had a frame that it has not painted; the first is the one that drives
        self.browsers: dict[Browser, float | None] = {}
        self._remote, self._away_s = remote, away_s
        self._alone_since_s: float | None = None  # None: somebody is there, or all that is due to that was done
        self._was_braked = False  # because the one that drives paints nothing

    @property
    def driver(self) -> Browser | None:
        return next(iter(self.browsers), None)

    def joined(self, browser: Browser) -> None:
        self.browsers[browser] = None
        self._alone_since_s = None
        self.manager.add_web_socket(browser)
        self._tell_roles()

    def left(self, browser: Browser) -> None:
        drove = browser is self.driver
        if self.browsers.pop(browser, 0) != 0:
            self.manager.remove_web_socket(browser)
        if drove:
            self._was_braked = False
            self._alone_since_s = time.monotonic()
            if self.browsers and self._away_s is not None:
                self._remote.act("brake", why="the browser that drove has left: braked")
        self._tell_roles()

    def painted(self, browser: Browser) -> None:
        """The browser says that it has painted the last frame."""
        self.browsers[browser] = None
        if browser is self.driver:
            self._was_braked = False

    def frame(self) -> None:
        """Ask for news, show them where somebody looks. Raises EOFError once the bench has ended."""
        now_s = time.monotonic()
        self._dead_man(now_s)
        news = self._remote.news()
        if news is None:
            return
        self.view.show(news, answered=news.handled == self._remote.actions)
        if self.browsers and not any(s is not None and now_s - s < ACK_LIMIT_S for s in self.browsers.values()):
            self.view.frame()

    def _dead_man(self, now_s: float) -> None:
        """Brake where the browser that drives is gone or paints nothing."""
        away_s, alone_s = self._away_s, self._alone_since_s
        if away_s is None:
            return
        if not self.browsers:
            if alone_s is not None and now_s - alone_s >= away_s:
                self._alone_since_s = None
                self._remote.act("brake", why=f"no browser for {away_s:g} s: braked")
            return
        sent_s = self.browsers[next(iter(self.browsers))]
        if sent_s is not None and now_s - sent_s >= away_s and not self._was_braked:
            self._was_braked = True
            self._remote.act("brake", why=f"the browser has painted nothing for {away_s:g} s: braked")

    def _tell_roles(self) -> None:
        for browser in list(self.browsers):
            browser.send_json({"type": "role", "drives": browser is self.driver})


class Browser(tornado.websocket.WebSocketHandler):
    """One browser's socket. Another site's page has another Origin and is refused by tornado."""

    def initialize(self, panel: Panel, door: Door) -> None:
        self.panel, self._door = panel, door
        self._credit, self._credited_s = BURST, time.monotonic()

    def prepare(self) -> None:
        self._door.check(self)

    def open(self, *args: str, **kwargs: str) -> None:
        if len(self.panel.browsers) >= MAX_BROWSERS:
            self.close(1013, "too many browsers")
        else:
            self.set_nodelay(True)
            self.panel.joined(self)

    def on_close(self) -> None:
        self.panel.left(self)

    def on_message(self, message: str | bytes) -> None:
        now_s = time.monotonic()
        self._credit = min(BURST, self._credit + RATE * (now_s - self._credited_s)) - 1.0
        self._credited_s = now_s
        if self._credit < 0.0:
            self._credit = 0.0
            return
        event = checked(message)
        if event is None or self not in self.panel.browsers:
            return
        if event["type"] == "ack":
            self.panel.painted(self)
        elif event["type"] not in ACTS or self is self.panel.driver:
            try:
                self.panel.manager.handle_json(event)
            except Exception as exc:  # what no figure can make sense of is not heard
                logger.info("a browser's message was refused: %s: %s", type(exc).__name__, exc)

    # what matplotlib calls

    def send_json(self, content: dict[str, Any]) -> None:
        self._send(json.dumps(content), binary=False)

    def send_binary(self, blob: bytes) -> None:
        if self.panel.browsers.get(self) is None:  # the oldest that is not painted counts
            self.panel.browsers[self] = time.monotonic()
        self._send(blob, binary=True)

    def _send(self, message: str | bytes, *, binary: bool) -> None:
        with suppress(tornado.websocket.WebSocketClosedError):  # on_close comes
            self.write_message(message, binary=binary).add_done_callback(lambda sent: sent.exception())


class Page(tornado.web.RequestHandler):
    """The page and matplotlib's script."""

    def initialize(self, door: Door) -> None:
        self._door = door

    def prepare(self) -> None:
        self._door.check(self)

    def get(self, name: str) -> None:
        self.set_header("X-Frame-Options", "DENY")
        self.set_header("Cache-Control", "no-store")
        self.set_header("Referrer-Policy", "no-referrer")  # the address has the token in it
        if name == "mpl.js":
            self.set_header("Content-Type", "application/javascript; charset=utf-8")
            self.write(webagg.FigureManagerWebAgg.get_javascript())
        else:
            page = files("fiohost.panel").joinpath("page.html").read_text(encoding="utf-8")
            self.write(page.replace("mpl.js", f"mpl.js?token={self._door.token}"))

    def write_error(self, status_code: int, **more: Any) -> None:
        self.finish("The panel is at the address that fiohost printed, token and all, under this computer's name.\n")


class Door:
    """Who may come in: with the token of the printed address, and under a name that is ours.

    A page elsewhere may have its name point here, but not a number, and not this computer's name.
    """

    def __init__(self, bind: str) -> None:
        self.token = secrets.token_urlsafe(16)
        self._names = {"localhost", socket.gethostname().lower(), bind.lower()}

    def check(self, handler: tornado.web.RequestHandler) -> None:
        """Raises HTTPError."""
        name = handler.request.host_name.strip("[]").lower()
        given = handler.get_query_argument("token", "")
        if not (self._is_ours(name) and hmac.compare_digest(given.encode(), self.token.encode())):
            raise tornado.web.HTTPError(403)

    def _is_ours(self, name: str) -> bool:
        if name in self._names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


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
    except (OSError, ValueError) as exc:  # ValueError: a name that cannot be one
        why = getattr(exc, "strerror", None) or exc
        raise FiohostError(
            f"cannot serve the panel at {shown(bind)}:{port}: {why}; --port 0 takes a free port, --bind an address of "
            "this computer"
        ) from exc
    door = Door(bind)
    pages: list[Any] = [("/socket", Browser, {"panel": panel, "door": door}), ("/(mpl.js)?", Page, {"door": door})]
    application = tornado.web.Application(
        pages,
        websocket_ping_interval=PING_S,
        websocket_ping_timeout=PING_S,
        websocket_max_message_size=MAX_MESSAGE_BYTES,
        log_function=lambda handler: None,
    )
    server = tornado.httpserver.HTTPServer(application, max_header_size=MAX_HEADER_BYTES, max_body_size=0)
    server.add_sockets(sockets)
    number = sockets[0].getsockname()[1]
    where = socket.gethostname() if bind in ("0.0.0.0", "::") else bind
    remote.ready(f"at http://{f'[{where}]' if ':' in where else where}:{number}/?token={door.token}")
    try:
        while True:
            panel.frame()
            await asyncio.sleep(FRAME_S)
    finally:
        server.stop()
        for browser in list(panel.browsers):
            browser.close(1001, "the session has ended")
        await asyncio.sleep(0.1)  # for the farewells to leave
