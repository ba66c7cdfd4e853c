"""A page of somebody else's, open in the browser beside the panel, drives nothing: in headless Chromium itself."""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from boards import rows_of
from desktop import Chromium, needed
from panel_runs import running
from places import PACKAGES

NAME = "elsewhere.example"
DRIVE = json.dumps({"type": "act", "name": "duty", "value": 60.0})
# opens sockets and asks for the page; says of each whether it was let in, and presses the slider where it was
ATTACK = """
(async () => {
  const socket = (address) => new Promise((done) => {
    const made = new WebSocket(address);
    made.onerror = () => done("refused");
    made.onopen = () => { made.send(PRESS); setTimeout(() => done("open"), 1000); };
  });
  const read = async (address) => {
    try { const got = await fetch(address); return got.ok ? "open" : "refused"; } catch (gone) { return "refused"; }
  };
  return await Promise.all([...SOCKETS.map(socket), ...PAGES.map(read)]);
})()
"""
FRAME = """
new Promise((done) => {
  const frame = document.createElement("iframe");
  frame.onload = () => setTimeout(() => done("loaded"), 1000);
  frame.src = ADDRESS;
  document.body.append(frame);
})
"""


def filled(script: str, **values: object) -> str:
    for name, value in values.items():
        script = script.replace(name, json.dumps(value))
    return script


@contextmanager
def page_elsewhere() -> Iterator[int]:
    """The port of a server with an empty page."""

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<html><body>come in</body></html>")

        def log_message(self, *_: object) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Page)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.parametrize("bind", [[], ["--bind", "0.0.0.0"]])
def test_a_page_from_elsewhere_drives_nothing_though_it_knows_the_token(
    bind: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the panel's number, by a name that was made to lead here, and in a frame. The same script drives from a page
    of the panel's own origin, and so does the panel's own page by the mouse.
    """
    needed("chromium")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(PACKAGES))
    with (
        page_elsewhere() as elsewhere,
        running("--web", "--port", "0", "--away", "20", *bind) as run,
        Chromium(tmp_path / "profile", NAME) as browser,
    ):
        printed = urlsplit(run.where().removeprefix("at "))
        port, token = printed.port, printed.query
        own, rebound = f"127.0.0.1:{port}", f"{NAME}:{port}"
        sockets = [f"ws://{at}/socket?{query}" for at in (own, rebound) for query in (token, "")]
        pages = [f"http://{at}/?{token}" for at in (own, rebound)]
        attack = filled(ATTACK, PRESS=DRIVE, SOCKETS=sockets, PAGES=pages)

        browser.open(f"http://{NAME}:{elsewhere}/")
        run.until(lambda: browser.value("document.body && document.body.innerText") == "come in")
        assert browser.value(attack) == ["refused"] * 6
        assert browser.value(filled(FRAME, ADDRESS=f"http://{own}/?{token}")) == "loaded"

        browser.open(f"http://{rebound}/?{token}")  # the name leads here now: pages of one origin, to the browser
        run.until(lambda: "token and all" in str(browser.value("document.body && document.body.innerText")))
        only_rebound = filled(ATTACK, PRESS=DRIVE, SOCKETS=sockets[2:], PAGES=pages[1:])
        assert browser.value(only_rebound) == ["refused"] * 3
        so_far = rows_of(tmp_path / "run.csv")[:-1]  # the last may be half written
        assert len(so_far) > 100
        assert all(row.split(",")[1:4] == ["0", "1", "1"] for row in so_far)

        browser.open(f"http://{own}/panel.js?{token}")  # the panel's origin, without the panel
        run.until(lambda: browser.value("location.host") == own and browser.value("document.readyState") == "complete")
        at_home = filled(ATTACK, PRESS=DRIVE, SOCKETS=sockets[:1], PAGES=pages[:1])
        assert browser.value(at_home) == ["open", "open"]
        run.until(lambda: run.drives(60.0))  # what was refused above is what drives

        browser.open(f"http://{own}/?{token}")
        run.until(lambda: (browser.value("window.fiohostPanel ? fiohostPanel.columns[0].length : 0") or 0) > 20)
        browser.put("#duty", "-40")
        browser.press("#set")
        run.until(lambda: run.drives(-40.0))
        run.process.send_signal(signal.SIGINT)
        assert run.ended()[0] == 130
