"""The panel in a browser: headless Chromium at both widths, sockets of strangers, floods, a page that freezes."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import signal
import socket
import subprocess
from pathlib import Path

import numpy as np
import pytest
from boards import HANG_S, rows_of
from desktop import Chromium, needed
from lines import PATIENT, PtyBoard
from panel_runs import Run, arrives, drives, joins, press, refuses, running
from places import PACKAGES
from test_cli_drive import FIOHOST
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from fiohost.bench.log import Log

LONG = "900"  # --away where nobody leaves: no load keeps a browser from painting for so long


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(PACKAGES))


def ready(run: Run, browser: Chromium) -> None:
    browser.open(run.where().removeprefix("at "))
    run.until(lambda: (browser.value("window.fiohostPanel ? fiohostPanel.columns[0].length : 0") or 0) > 20)


def test_in_a_browser_the_mouse_drives_brakes_and_stops(tmp_path: Path) -> None:
    needed("chromium")
    with running("--web", "--port", "0", "--away", LONG) as run, Chromium(tmp_path / "profile") as browser:
        ready(run, browser)
        browser.put("#duty", "50")
        browser.press("#set")
        run.until(lambda: run.drives(50.0))
        browser.press("#brake")
        run.until(run.braked)
        browser.put("#duty", "-80")
        browser.press("#set")
        run.until(lambda: run.drives(-80.0))
        browser.press("#emergency")
        run.until(run.braked)
        browser.press("#set")  # not obeyed
        run.until(lambda: "STOPPED" in browser.value("document.getElementById('now').innerText"))
        browser.press("#release")
        run.until(lambda: "STOPPED" not in browser.value("document.getElementById('now').innerText"))
        assert run.braked()
        browser.put("#duty", "-30")
        browser.press("#set")
        run.until(lambda: run.drives(-30.0))
        run.process.send_signal(signal.SIGINT)
        code, said, log = run.ended()
        assert code == 130, said
        assert log.metadata["ending"] == "stopped by Ctrl-C"


def test_leaving_the_page_brakes(tmp_path: Path) -> None:
    needed("chromium")
    with running("--web", "--port", "0", "--away", "5") as run, Chromium(tmp_path / "profile") as browser:
        ready(run, browser)
        browser.put("#duty", "-30")
        asked = itertools.count()

        def drives() -> bool:
            """Asked for every second or so: where load keeps the page from painting it is braked for."""
            if next(asked) % 50 == 0:
                browser.press("#set")
            return run.drives(-30.0)

        run.until(drives)
        browser.close_tab()
        run.until(run.braked)
        run.process.send_signal(signal.SIGINT)
        assert run.ended()[0] == 130


INSIDE = """(() => { const box = document.getElementById("emergency").getBoundingClientRect();
  const hit = document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2);
  return box.left >= 0 && box.right <= innerWidth && box.top >= 0 && box.bottom <= innerHeight
    && hit.closest("#emergency") !== null && document.documentElement.scrollWidth <= innerWidth; })()"""
DRAWN = """fiohostPanel.plots.every(p => { const c = p.ctx.canvas, d = p.ctx.getImageData(0, 0, c.width, c.height).data;
  let inked = 0; for (let i = 3; i < d.length; i += 4) if (d[i] > 200) inked++;
  return inked > 500; })"""


@pytest.mark.long
@pytest.mark.parametrize("width_px", [1200, 400])
def test_at_both_widths_the_stop_is_in_sight_and_sources_loops_records_and_zoom_work(
    tmp_path: Path, width_px: int
) -> None:
    needed("chromium")
    with running("--web", "--port", "0", "--away", LONG) as run, Chromium(tmp_path / "profile") as browser:
        browser.width(width_px, 800)
        ready(run, browser)
        for place in (0, 300, 5000):  # wherever the page is scrolled to
            browser.value(f"window.scrollTo(0, {place})")
            assert browser.value(INSIDE) is True
        browser.put("#s-shape", "square")
        browser.put("#s-amplitude", "30")
        browser.put("#s-period_s", "1000")
        browser.press("#source")
        run.until(lambda: run.drives(30.0) and browser.value("document.getElementById('source').innerText") == "Stop")
        browser.put("#s-offset", "10")  # at once
        run.until(lambda: run.drives(40.0))
        browser.press("#record")
        run.until(lambda: [p for p in Path.cwd().glob("panel-*.csv") if len(rows_of(p)) > 50])
        browser.press("#record")
        browser.put("#l-kind", "pid")
        browser.put("#l-offset", "0")
        browser.press("#loop")
        run.until(lambda: browser.value("fiohostPanel.columns[2].some(v => v === 0)"))
        run.until(lambda: browser.value("document.getElementById('loop').innerText") == "Stop")
        browser.put("#l-offset", "33")
        run.until(lambda: browser.value("fiohostPanel.columns[2].some(v => v === 33)"))
        assert browser.value(DRAWN) is True
        browser.press("#pause")
        assert browser.value("fiohostPanel.isPaused()") is True
        ends = "JSON.stringify(fiohostPanel.plots.map(p => [p.scales.x.min, p.scales.x.max]))"
        before = json.loads(browser.value(ends))
        browser.value("fiohostPanel.zoom(fiohostPanel.columns[0][0], fiohostPanel.columns[0][10])")
        run.until(lambda: json.loads(browser.value(ends)) != before)
        zoomed = json.loads(browser.value(ends))
        assert zoomed[0] == zoomed[1] == zoomed[2]
        exported = Log.parse(browser.value("fiohostPanel.csv()"))
        assert 5 <= len(exported) <= 12
        browser.press("#emergency")
        run.until(run.braked)
        run.process.send_signal(signal.SIGINT)
        assert run.ended()[0] == 130
    (path,) = Path.cwd().glob("panel-*.csv")
    assert Log.read(path).metadata["ending"] == "complete"


def test_a_browser_that_paints_nothing_is_braked_for_though_its_socket_lives() -> None:
    """The pictures are the dead man's switch: pings are answered by a frozen page too."""

    async def session(run: Run) -> None:
        browser = await joins(run)
        await drives(run, browser, 60.0)
        browser.frozen = True
        await arrives(run.braked)
        browser.frozen = False
        await browser.send('{"type": "ack"}')
        await drives(run, browser, -40.0)  # back, and asked for
        run.process.send_signal(signal.SIGINT)

    with running("--web", "--port", "0", "--away", "5") as run:
        asyncio.run(session(run))
        assert run.ended()[0] == 130


def test_one_browser_drives_at_a_time_and_floods_and_nonsense_change_nothing() -> None:
    async def session(run: Run) -> None:
        first, second = await joins(run), await joins(run)
        await second.send(press(80.0))
        await first.send(press(50.0))
        await arrives(lambda: run.drives(50.0))
        for key in ("", "Shift", "\u0000", "x" * 3000, "ctrl+\ud800", "F99"):
            await first.send(json.dumps({"type": "act", "name": key, "value": 90.0}))
        for _ in range(3000):
            await second.send(press(80.0))
        await asyncio.sleep(3.0)  # the flood is past: what is left of it would be its own wish when it drives
        await arrives(lambda: run.drives(50.0))
        first.close()
        await arrives(run.braked)  # the second may drive now, and has to ask for it
        for _ in range(200):  # until its flood is forgotten
            await asyncio.sleep(1.0)
            await second.send(press(-40.0))
            if run.drives(-40.0):
                break
        await arrives(lambda: run.drives(-40.0))
        run.process.send_signal(signal.SIGINT)

    with running("--web", "--port", "0", "--away", LONG) as run:
        asyncio.run(session(run))
        code, said, log = run.ended()
        assert code == 130
        assert "Traceback" not in said
    driven = np.flatnonzero(log.duty_pct == 50.0)
    left = driven[0] + np.flatnonzero(log.duty_pct[driven[0] :] == 0.0)[0]  # the brake when the first has left
    assert log.duty_pct[:left].max() < 60.0


@pytest.mark.parametrize("bind", ["127.0.0.1", "0.0.0.0"])
def test_names_of_others_and_addresses_without_the_token_are_refused(bind: str) -> None:
    async def session(run: Run) -> None:
        where = run.where().removeprefix("at ").replace(f"//{socket.gethostname()}:", "//127.0.0.1:")
        plain, _, token = where.partition("?")
        assert len(token) > 20
        assert await refuses(where, Host="rebound.example")
        assert await refuses(plain)
        assert await refuses(plain + "?token=" + "x" * 22)
        assert await refuses(plain + "panel.js")
        assert not await refuses(where)
        for bad in (plain + "socket", where.replace("/?", "/socket?")):
            headers = {"Host": "rebound.example"} if "token" in bad else {}
            with pytest.raises(HTTPClientError, match="403"):
                await websocket_connect(HTTPRequest(bad.replace("http://", "ws://"), headers=headers))
        run.process.send_signal(signal.SIGINT)

    with running("--web", "--port", "0", "--bind", bind) as run:
        asyncio.run(session(run))
        assert run.process.wait(HANG_S) == 130


@pytest.mark.long
@pytest.mark.parametrize("bind", ["127.0.0.1/../", "no such name", "x" * 300, "\x1b[2J", "203.0.113.7"])
def test_an_address_that_is_none_is_refused_in_one_sentence(bind: str) -> None:
    done = subprocess.run([*FIOHOST, "panel", "--web", "--bind", bind], capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert "cannot serve the panel at" in done.stderr


def test_a_board_that_goes_silent_leaves_no_traceback(tmp_path: Path) -> None:
    guards = [f"--guard={key}={value}" for key, value in PATIENT.items()]
    with PtyBoard() as board, running("--web", "--port", "0", "--target", f"serial:{board.target}", *guards) as run:
        run.until(run.braked)
        board.unplug()
        assert run.process.wait(HANG_S) == 1
    said = "\n".join(run.said())
    assert "went away" in said
    assert "ConnectionResetError" not in said
    assert "Process fiohost-panel" not in said


def test_a_hostile_page_in_a_browser_cannot_drive(tmp_path: Path) -> None:
    """It opens sockets and frames to every name of this computer, without the token."""
    needed("chromium")
    with running("--web", "--port", "0") as run, Chromium(tmp_path / "profile") as browser:
        port = run.where().partition(":")[2].partition(":")[2].partition("/")[0]
        hostile = tmp_path / "hostile.html"
        hostile.write_text(
            "<script>window.tried = 0; window.opened = 0;"
            "for (const host of ['127.0.0.1', 'localhost', '[::1]']) {"
            " for (const rest of ['', '?token=', '?token=a']) {"
            f"  const s = new WebSocket(`ws://${{host}}:{port}/socket${{rest}}`);"
            f"  s.onopen = () => {{ window.opened++; s.send({json.dumps(press(90.0))}); }};"
            "   s.onerror = () => { window.tried++; };"
            f"  fetch(`http://${{host}}:{port}/${{rest}}`).then(r => r.text()).then(t => "
            "     { if (t.includes('token')) window.opened++; }).catch(() => {});"
            "}}</script>"
        )
        browser.open(hostile.as_uri())
        run.until(lambda: (browser.value("window.tried") or 0) >= 9)
        assert browser.value("window.opened") == 0
        run.until(run.braked)  # on a busy machine the page may have tried all before the first report
        run.process.send_signal(signal.SIGINT)
        code, _, log = run.ended()
        assert code == 130
    assert not log.duty_pct.any()


def test_sockets_that_leave_strangers_and_a_killed_display_all_leave_the_motor_braked() -> None:
    async def session(run: Run) -> None:
        where = run.where().removeprefix("at ")
        address = where.replace("http://", "ws://").replace("/?", "/socket?")
        assert where.startswith("http://127.0.0.1:")
        assert await refuses(where, Host="evil.example")  # a name elsewhere made to point here
        with pytest.raises(HTTPClientError, match="403"):
            await websocket_connect(HTTPRequest(address, headers={"Origin": "http://evil.example"}))
        browser = await joins(run)
        await browser.send("nonsense")
        await drives(run, browser, 60.0)
        browser.close()
        await arrives(run.braked)  # the last has gone
        again = await joins(run)
        await drives(run, again, -40.0)
        os.kill(run.display(), signal.SIGKILL)

    with running("--web", "--port", "0", "--away", "20") as run:
        asyncio.run(session(run))
        code, said, log = run.ended()
    assert code == 1
    assert said.splitlines()[0] == "fiohost: the panel died and the motor was braked"
    assert log.duty_pct[-1] == pytest.approx(-40.0, abs=2.0)
    assert "the panel died" in log.metadata["ending"]
