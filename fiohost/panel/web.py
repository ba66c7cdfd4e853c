"""The panel in a browser: readings go over a web socket, the browser draws them.

Who drives is watched by the pictures themselves: a browser that does not say that it has painted a frame, for as long
as ``--away`` allows, is taken for gone and the motor is braked. One browser drives, the first; others look on. The
address has a token, names that are not ours are refused (Host and Origin are checked, on every address), and of what a
browser sends only known actions are taken, within bounds of size and rate.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import json
import secrets
import socket
import time
from collections import deque
from contextlib import suppress
from dataclasses import asdict
from importlib.resources import files
from typing import Any

from fiohost.errors import FiohostError
from fiohost.files import shown
from fiohost.panel.link import READING_S, Facts, News, Reading, Remote

try:
    import tornado.httpserver
    import tornado.web
    import tornado.websocket
except ImportError as exc:
    raise FiohostError(f"the panel in a browser needs the package tornado ({exc}): pip install tornado") from exc

FRAME_S = 0.08
PING_S = 10.0  # a browser that answers no ping for so long has gone; who drives is watched by frames
MAX_MESSAGE_BYTES = 4000
MAX_HEADER_BYTES = 16_000
MAX_BROWSERS = 20
RATE = 200.0  # messages a second ...
BURST = 400.0  # ... and so many at once; more are not heard
HISTORY = 3000  # readings that a browser which joins is given: a minute
PLAIN = {"brake", "standby", "reverse", "emergency", "release"}
NUMBERED = {"duty", "change"}
SETTINGS = {
    "source": {"amplitude", "offset", "period_s"},
    "loop": {"kp", "ki", "kd", "amplitude", "offset", "period_s"},
}
WORDS = {"shape", "kind"}
MOST = 1e6  # of any number: what is sane is asked by the bench's side
SCRIPTS = {
    "panel.js": ("fiohost.panel", "panel.js", "application/javascript"),
    "uplot.js": ("fiohost.report", "vendor/uPlot.iife.min.js", "application/javascript"),
    "uplot.css": ("fiohost.report", "vendor/uPlot.min.css", "text/css"),
}


class Panel:
    """The browsers that show the bench, and their frames."""

    def __init__(self, remote: Remote, facts: Facts, away_s: float | None) -> None:
        self.facts = facts
        # since when each has had a frame that it has not painted; the first is the one that drives
        self.browsers: dict[Browser, float | None] = {}
        self._history: deque[Reading] = deque(maxlen=HISTORY)
        self._remote, self.away_s = remote, away_s
        self._alone_since_s: float | None = None  # None: somebody is there, or all that is due to that was done
        self._was_braked = False  # because the one that drives paints nothing

    @property
    def driver(self) -> Browser | None:
        return next(iter(self.browsers), None)

    def joined(self, browser: Browser) -> None:
        self.browsers[browser] = None
        self._alone_since_s = None
        browser.send_json({"type": "facts", "reading_s": READING_S, **asdict(self.facts)})
        browser.waiting.extend(self._history)
        self._tell_roles()

    def left(self, browser: Browser) -> None:
        drove = browser is self.driver
        self.browsers.pop(browser, None)
        if drove:
            self._was_braked = False
            self._alone_since_s = time.monotonic()
            if self.browsers and self.away_s is not None:
                self._remote.act("brake", why="the browser that drove has left: braked")
        self._tell_roles()

    def painted(self, browser: Browser) -> None:
        """The browser says that it has painted the last frame."""
        self.browsers[browser] = None
        if browser is self.driver:
            self._was_braked = False

    def act(self, name: str, value: Any) -> None:
        self._remote.act(name, value)

    def frame(self) -> None:
        """Ask for news, show them where the last ones were painted. Raises EOFError once the bench has ended."""
        now_s = time.monotonic()
        self._dead_man(now_s)
        news = self._remote.news()
        if news is None:
            return
        self._history.extend(news.readings)
        for browser, since_s in self.browsers.items():
            browser.waiting.extend(news.readings)
            if since_s is None:
                self.browsers[browser] = now_s
                browser.show(news, answered=news.handled == self._remote.actions)

    def _dead_man(self, now_s: float) -> None:
        """Brake where the browser that drives is gone or paints nothing."""
        away_s, alone_s = self.away_s, self._alone_since_s
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
        self.waiting: deque[Reading] = deque(maxlen=HISTORY)  # what it has not been shown

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
        elif self is self.panel.driver:
            self.panel.act(event["name"], event["value"])

    def show(self, news: News, *, answered: bool) -> None:
        """Send a frame: the news, with all readings that this browser has not had."""
        told = asdict(news) | {"readings": [list(r) for r in self.waiting]}
        self.waiting.clear()
        self.send_json({"type": "news", "answered": answered, **told})

    def send_json(self, content: dict[str, Any]) -> None:
        with suppress(tornado.websocket.WebSocketClosedError):  # on_close comes
            self.write_message(json.dumps(content)).add_done_callback(lambda sent: sent.exception())


class Page(tornado.web.RequestHandler):
    """The page, and what it draws with."""

    def initialize(self, door: Door) -> None:
        self._door = door

    def prepare(self) -> None:
        self._door.check(self)

    def get(self, name: str | None = None) -> None:
        if name and name not in SCRIPTS:
            raise tornado.web.HTTPError(404)
        self.set_header("X-Frame-Options", "DENY")
        self.set_header("Cache-Control", "no-store")
        self.set_header("Referrer-Policy", "no-referrer")  # the address has the token in it
        if name in SCRIPTS:
            package, path, kind = SCRIPTS[name]
            self.set_header("Content-Type", f"{kind}; charset=utf-8")
            self.write(files(package).joinpath(path).read_text(encoding="utf-8"))
            return
        page = files("fiohost.panel").joinpath("page.html").read_text(encoding="utf-8")
        for script in SCRIPTS:
            page = page.replace(f'"{script}"', f'"{script}?token={self._door.token}"')
        self.write(page)

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
    """What is taken of a browser's message: that it has painted, or an action with its value; else None."""
    try:
        came = json.loads(message)
    except (ValueError, RecursionError):
        return None
    if not isinstance(came, dict):
        return None
    if came.get("type") == "ack":
        return {"type": "ack"}
    name: Any = came.get("name")
    value: Any = came.get("value")
    if came.get("type") != "act" or not isinstance(name, str):
        return None
    if name in PLAIN:
        return {"type": "act", "name": name, "value": None}
    if name in NUMBERED and _is_number(value):
        return {"type": "act", "name": name, "value": float(value)}
    if name == "record" and isinstance(value, bool):
        return {"type": "act", "name": name, "value": value}
    if name in SETTINGS and isinstance(value, dict):
        kept = {key: float(value[key]) for key in SETTINGS[name] if _is_number(value.get(key))}
        said = {key: value[key] for key in WORDS if isinstance(value.get(key), str) and len(value[key]) <= 20}
        if len(kept) + len(said) == len(value):
            return {"type": "act", "name": name, "value": {**kept, **said}}
    return None


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and -MOST <= value <= MOST


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
    pages: list[Any] = [
        ("/socket", Browser, {"panel": panel, "door": door}),
        ("/([a-z]+[.][a-z]+)?", Page, {"door": door}),
    ]
    ping_s = max(PING_S, panel.away_s or 0.0)  # one that may be away for longer is not cut off sooner
    application = tornado.web.Application(
        pages,
        websocket_ping_interval=ping_s,
        websocket_ping_timeout=ping_s,
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
