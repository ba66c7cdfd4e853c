"""A screen, a mouse and a browser for tests: Xvfb with xdotool, and headless Chromium over its DevTools protocol."""

from __future__ import annotations

import asyncio
import base64
import ctypes
import importlib.util
import json
import os
import re
import shutil
import signal
import subprocess
import urllib.request
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest
from boards import until
from tornado.websocket import websocket_connect


def needed(*programs: str) -> None:
    """Skip loudly where one is absent; with FIOHOST_NEEDS_DESKTOP set, as in the gate, fail."""
    absent = [name for name in programs if shutil.which(name) is None]
    if "Xvfb" in programs and importlib.util.find_spec("_tkinter") is None:
        absent.append("Python's Tk")
    if absent:
        reason = f"NOT TESTED, ABSENT: {', '.join(absent)} (apt-get install xvfb xdotool chromium python3-tk)"
        if os.environ.get("FIOHOST_NEEDS_DESKTOP"):
            pytest.fail(reason)
        pytest.skip(reason)


class Screen:
    """A virtual X display with a mouse; places are fractions of a window, from its lower left corner."""

    def __enter__(self) -> Self:
        read, write = os.pipe()
        # at 96 dpi Tk leaves a window as large as it was asked for
        command = ["Xvfb", "-displayfd", str(write), "-screen", "0", "1366x768x24", "-dpi", "96", "-nolisten", "tcp"]
        self._server = subprocess.Popen(command, pass_fds=[write], stderr=subprocess.DEVNULL)
        os.close(write)
        with os.fdopen(read) as told:
            self.name = f":{told.readline().strip()}"
        self.environment = {**os.environ, "DISPLAY": self.name, "MPLBACKEND": "TkAgg"}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.kill()
        self._server.wait()

    def _do(self, *arguments: str) -> str:
        done = subprocess.run(["xdotool", *arguments], env=self.environment, capture_output=True, text=True)
        return done.stdout.strip()

    def window(self, title: str) -> str:
        return str(until(lambda: self._do("search", "--name", title))).splitlines()[-1]

    def click(self, window: str, x: float, y: float, size_px: tuple[int, int] | None = None) -> None:
        """Click at fractions of the window from its lower left corner, or of what is so large at its upper left."""
        size = self._geometry(window)
        wide, high = size_px or (size["WIDTH"], size["HEIGHT"])
        at = (size["X"] + x * wide, size["Y"] + (1.0 - y) * high)
        self._do("mousemove", *(str(round(a)) for a in at), "click", "1")

    def _geometry(self, window: str) -> dict[str, int]:
        shell = self._do("getwindowgeometry", "--shell", window)
        return {key: int(number) for key, number in re.findall(r"(\w+)=(-?\d+)", shell)}

    def size(self, window: str) -> tuple[int, int]:
        """Width and height in pixels."""
        size = self._geometry(window)
        return size["WIDTH"], size["HEIGHT"]

    def close(self, window: str) -> None:
        """What the cross in a window's corner sends."""

        class Message(ctypes.Structure):
            _fields_ = (
                ("type", ctypes.c_int), ("serial", ctypes.c_ulong), ("send_event", ctypes.c_int),
                ("display", ctypes.c_void_p), ("window", ctypes.c_ulong), ("message_type", ctypes.c_ulong),
                ("format", ctypes.c_int), ("data", ctypes.c_long * 5), ("room", ctypes.c_long * 24),
            )  # fmt: skip

        x11 = ctypes.CDLL("libX11.so.6")
        x11.XOpenDisplay.restype = ctypes.c_void_p
        x11.XInternAtom.restype = ctypes.c_ulong
        display = ctypes.c_void_p(x11.XOpenDisplay(self.name.encode()))
        protocols, delete = (x11.XInternAtom(display, n, 0) for n in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW"))
        message = Message(type=33, window=int(window), message_type=protocols, format=32)
        message.data[0] = delete
        x11.XSendEvent(display, ctypes.c_ulong(int(window)), 0, ctypes.c_long(0), ctypes.byref(message))
        x11.XCloseDisplay(display)

    def picture(self, path: Path) -> None:
        from PIL import ImageGrab

        ImageGrab.grab(xdisplay=self.name).save(path)


class Chromium:
    """A headless browser with one tab; *names* lead to this computer, as where somebody else's name server says so."""

    def __init__(self, profile: Path, *names: str) -> None:
        self._profile = profile
        self._rules = ", ".join(f"MAP {name} 127.0.0.1" for name in names)
        self._loop = asyncio.new_event_loop()
        self._number = 0

    def __enter__(self) -> Self:
        flags = ["--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-extensions",
                 "--disable-background-networking", "--disable-component-update", "--disable-dev-shm-usage",
                 "--window-size=1200,860", "--remote-debugging-port=0", f"--user-data-dir={self._profile}"]  # fmt: skip
        flags += [f"--host-resolver-rules={self._rules}"] if self._rules else []
        null = subprocess.DEVNULL
        command = ["chromium", *flags, "about:blank"]
        self._process = subprocess.Popen(command, stdin=null, stdout=null, stderr=null, start_new_session=True)
        told = self._profile / "DevToolsActivePort"
        port = until(lambda: told.exists() and told.read_text().partition("\n")[0])
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            tab = next(page for page in json.load(answer) if page["type"] == "page")
        self._socket = self._loop.run_until_complete(self._connect(tab["webSocketDebuggerUrl"]))
        self._call("Page.enable")
        return self

    async def _connect(self, address: str) -> Any:
        return await websocket_connect(address, max_message_size=1 << 26)

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._loop.close()
        os.killpg(self._process.pid, signal.SIGKILL)  # the browser and all that it has started
        self._process.wait()

    def _call(self, method: str, **parameters: Any) -> Any:
        self._number += 1
        asked = {"id": self._number, "method": method, "params": parameters}

        async def call() -> Any:
            await self._socket.write_message(json.dumps(asked))
            while True:
                came = await self._socket.read_message()
                assert came is not None, "the browser has gone"
                answer = json.loads(came)
                if answer.get("id") == asked["id"]:
                    assert "result" in answer, answer
                    return answer["result"]

        return self._loop.run_until_complete(call())

    def open(self, url: str) -> None:
        self._call("Page.navigate", url=url)

    def shown(self, page: Path) -> str:
        """The elements of a file's page, once it and all that it carries has been drawn."""
        self.open(page.as_uri())
        until(lambda: self.value("location.protocol == 'file:' && document.readyState") == "complete")
        return str(self.value("document.documentElement.outerHTML"))

    def close_tab(self) -> None:
        """Leave the page; the browser lives on."""
        self._call("Page.navigate", url="about:blank")

    def value(self, script: str) -> Any:
        """What a script says, or, where it promises something, what comes of that."""
        asked = {"expression": script, "returnByValue": True, "awaitPromise": True}
        return self._call("Runtime.evaluate", **asked)["result"].get("value")

    def click(self, x: float, y: float) -> None:
        """Click on the canvas, at fractions of it from its lower left corner."""
        box = self.value("document.querySelector('canvas').getBoundingClientRect().toJSON()")
        at = {"x": box["x"] + x * box["width"], "y": box["y"] + (1.0 - y) * box["height"]}
        for kind in ("mousePressed", "mouseReleased"):
            self._call("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **at)

    def press(self, selector: str) -> None:
        """Click on an element where a hand would: in its middle, wherever it is on the page."""
        box = self.value(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            "e.scrollIntoView({block: 'center'});"
            "return e.getBoundingClientRect().toJSON(); })()"
        )
        at = {"x": box["x"] + 0.5 * box["width"], "y": box["y"] + 0.5 * box["height"]}
        for kind in ("mousePressed", "mouseReleased"):
            self._call("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **at)

    def put(self, selector: str, value: object) -> None:
        """Write into a field, as a person who leaves it then."""
        self.value(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)}); e.value = {json.dumps(value)};"
            "e.dispatchEvent(new Event('change', {bubbles: true})); })()"
        )

    def width(self, width_px: int, height_px: int) -> None:
        """Make the page so large, as on a phone."""
        self._call(
            "Emulation.setDeviceMetricsOverride", width=width_px, height=height_px, deviceScaleFactor=1, mobile=True
        )

    def picture(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self._call("Page.captureScreenshot")["data"]))
