"""``fiohost panel``: what a person may ask of it, and that the motor is braked whatever becomes of it."""

from __future__ import annotations

import asyncio
import json
import math
import multiprocessing
import os
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from boards import WatchedTransport, bench_on, rows_of
from desktop import Chromium, Screen, needed, until
from lines import PtyBoard
from test_cli_drive import FIOHOST, ROOT, refused
from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from fiohost.bench.log import Log
from fiohost.errors import FiohostError, LimitError
from fiohost.panel import link
from fiohost.panel.controls import Controls
from fiohost.panel.link import PanelProgram
from fiohost.panel.web import checked
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND

SLIDER_Y, BUTTONS_Y, STOP = 0.175, 0.08, (0.86, 0.13)
BRAKE_BUTTON_X, RELEASE_BUTTON_X = 0.11, 0.63
SIZE_PX = (1080, 660)


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))


def slider_x(duty_pct: float) -> float:
    return 0.04 + 0.67 * (duty_pct + 100.0) / 200.0


# ---- what may be asked ---------------------------------------------------------------------------------------------


def test_duty_is_bounded_by_the_limit_of_the_target_and_zero_brakes() -> None:
    controls = Controls(limit_pct=60.0)
    assert controls.command == BRAKE_COMMAND
    for asked, got in ((40, 40.0), (99.0, 60.0), (-1e5, -60.0), (0, 0.0)):
        controls.act("duty", asked)
        assert controls.command.duty_pct == got
    assert controls.command == BRAKE_COMMAND
    controls.act("change", 500.0)
    controls.act("reverse")
    assert (controls.command.duty_pct, controls.command.c3, controls.command.c4) == (-60.0, 0, 1)
    controls.act("standby")
    assert controls.command == STANDBY_COMMAND


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "40", None, True, [40], 10**400, {}])
def test_what_is_no_finite_number_is_refused_and_changes_nothing(value: object) -> None:
    controls = Controls()
    controls.act("duty", 30)
    for name in ("duty", "change"):
        with pytest.raises(LimitError, match="finite number"):
            controls.act(name, value)
    with pytest.raises(LimitError, match="did you mean 'standby'"):
        controls.act("stanby")
    assert controls.command.duty_pct == 30.0


def test_after_an_emergency_stop_only_its_release_is_obeyed_and_that_brakes() -> None:
    controls = Controls()
    controls.act("duty", 80)
    controls.act("emergency")
    for name, value in (("duty", 50.0), ("change", 5.0), ("standby", None), ("reverse", None), ("brake", None)):
        controls.act(name, value)
        assert (controls.command, controls.stopped) == (BRAKE_COMMAND, True)
    controls.act("release")
    assert (controls.command, controls.stopped) == (BRAKE_COMMAND, False)
    controls.act("duty", 50.0)
    assert controls.command.duty_pct == 50.0


@pytest.mark.parametrize(
    "message",
    ["", "[]", "7", '{"type": []}', '{"type": "eval"}', '{"type": "toolbar_button", "name": "save_figure"}', "[" * 9999,
     '{"type": "button_press", "x": NaN, "y": 1}', '{"type": "motion_notify", "x": "1", "y": 1}',
     '{"type": "resize", "width": 1e9, "height": 600}', '{"type": "resize", "width": 600}',
     '{"type": "set_device_pixel_ratio", "device_pixel_ratio": 1000}', '{"type": "key_press", "key": 7}'],
)  # fmt: skip
def test_of_what_a_browser_sends_only_bounded_events_of_the_figure_are_taken(message: str) -> None:
    assert checked(message) is None
    press = {"type": "button_press", "x": 3, "y": 4.5, "button": 0, "buttons": 1, "modifiers": ["ctrl"], "guiEvent": {}}
    taken = checked(json.dumps(press))
    assert taken == {"type": "button_press", "x": 3.0, "y": 4.5, "button": 0, "buttons": 1, "step": 0.0,
                     "modifiers": []}  # fmt: skip


# ---- the bench's side of the link ----------------------------------------------------------------------------------


class Script:
    """A display that sends given messages at given ticks, and keeps what it is answered."""

    def __init__(self, messages: dict[int, bytes | type[Exception]]) -> None:
        self.answers: list[Any] = []
        self._messages, self._tick = messages, -1

    def poll(self) -> bool:
        self._tick += 1
        return self._tick in self._messages

    def recv_bytes(self, most: int) -> bytes:
        message = self._messages[self._tick]
        if isinstance(message, bytes):
            return message
        raise message

    def send_bytes(self, answer: bytes) -> None:
        self.answers.append(json.loads(answer))


def play(messages: dict[int, Any], **limits: float) -> tuple[WatchedTransport, Script, Callable[[], int]]:
    transport, script = WatchedTransport(), Script(messages)
    bench = bench_on(transport, **limits)
    program = PanelProgram(bench, script, "the panel died")  # type: ignore[arg-type]
    return transport, script, lambda: bench.live(program, "run.csv", None, program, link.READING_S)


def act(name: str, value: float | None = None) -> bytes:
    return json.dumps({"act": name, "value": value}).encode()


def test_the_bench_answers_frames_obeys_and_ends_when_the_display_is_closed() -> None:
    frame = b'{"frame": true}'
    transport, script, run = play({2: act("duty", 40.0), 200: act("duty", math.nan), 210: frame, 400: frame,
                                   410: b'{"closed": true}'})  # fmt: skip
    rows = run()
    assert transport.braked
    log = Log.read("run.csv")
    assert len(log) == rows
    assert log.metadata["ending"] == "complete"
    first, second = script.answers
    assert (first["mode"], first["duty_pct"], first["handled"]) == ("drive", 40.0, 2)
    assert "finite number" in first["note"]
    times = [row[0] for row in first["readings"] + second["readings"]]
    assert times == sorted(set(times))  # each reading once
    assert second["readings"][-1][4] == int(log.columns["pos"][round(times[-1] / 0.005)])


def test_the_limits_of_the_target_hold_for_a_person_too() -> None:
    _, _, run = play({2: act("duty", 90.0), 400: b'{"closed": true}'}, duty_pct=30.0, slew_pct_per_s=100.0)
    run()
    log = Log.read("run.csv")
    assert max(log.duty_pct) == 30.0
    assert np.diff(log.duty_pct).max() <= 0.5 + 1e-4
    for limit in ({"travel_deg": 90.0}, {"run_time_s": 0.5}):
        Path("run.csv").unlink()
        transport, _, run = play({2: act("duty", 70.0)}, **limit)
        with pytest.raises(LimitError, match="limit of"):
            run()
        assert transport.braked


@pytest.mark.parametrize(
    "last", [EOFError, OSError, b"no json", b"[1]", b'{"frame": 1}', b'{"act": 5}', b'{"closed": true, "x": '],
)  # fmt: skip
def test_a_display_that_dies_or_raves_is_braked_for_and_the_log_is_whole(last: Any) -> None:
    transport, _, run = play({2: act("duty", 70.0), 100: last})
    with pytest.raises(FiohostError, match="the panel died"):
        run()
    assert transport.braked
    log = Log.read("run.csv")
    assert log.duty_pct[-1] == 70.0
    assert "the panel died" in log.metadata["ending"]


def test_a_display_that_hangs_is_braked_for_and_may_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter(i * 0.005 for i in range(10_000))
    monkeypatch.setattr(link.time, "monotonic", lambda: next(now))
    _, script, run = play({2: act("duty", 70.0), 600: b'{"frame": true}', 700: act("duty", 20.0),
                           800: b'{"closed": true}'})  # fmt: skip
    run()
    log = Log.read("run.csv")
    braked = [k for k in range(1, len(log)) if log.duty_pct[k] == 0.0 and log.duty_pct[k - 1] != 0.0]
    assert len(braked) == 1
    assert braked[0] * 0.005 == pytest.approx(link.HANG_S, abs=0.05)
    assert "did not answer" in script.answers[0]["note"]
    assert log.duty_pct[-1] == 20.0


def test_a_display_that_was_closed_stays_until_the_bench_has_heard_it() -> None:
    bench, display = multiprocessing.Pipe()

    def leave() -> None:
        link.Remote(display).closed()
        display.close()

    bench.send_bytes(b"an answer that nobody waits for any more")
    leaving = threading.Thread(target=leave)
    leaving.start()
    leaving.join(0.3)
    assert leaving.is_alive()
    assert json.loads(bench.recv_bytes()) == {"closed": True}
    bench.close()
    leaving.join(2.0)
    assert not leaving.is_alive()


# ---- the command ---------------------------------------------------------------------------------------------------


def test_what_makes_no_sense_is_refused_before_anything_is_opened() -> None:
    for arguments, reason in (
        (["--port", "80"], "add --web"),
        (["--web", "--port", "99999"], "--port"),
        (["--web", "--away", "nan"], "--away"),
        (["--target", "nowhere"], "unknown target"),
    ):
        assert reason in refused("panel", *arguments)


class Run:
    """The command in a process of its own, with its traffic on standard error and its log in ``run.csv``."""

    def __init__(self, *arguments: str, environment: dict[str, str] | None = None) -> None:
        command = [*FIOHOST, "--debug", "panel", "--log", "run.csv", *arguments]
        self.out, self.errors = Path("out.txt"), Path("errors.txt")
        with self.out.open("w") as out, self.errors.open("w") as errors:
            self.process = subprocess.Popen(command, stdout=out, stderr=errors, env=environment)

    def until(self, what: Callable[[], Any]) -> Any:
        """Wait until *what* gives something true while the command runs."""

        def asked() -> Any:
            assert self.process.poll() is None, "\n".join(self.said()[-20:])
            return what()

        return until(asked)

    def said(self) -> list[str]:
        """Standard error without the traffic."""
        return [line for line in self.errors.read_text().splitlines() if not line.startswith("fiohost.")]

    def where(self) -> str:
        return str(self.until(lambda: self.out.read_text().partition("panel ")[2].partition(";")[0]))

    @staticmethod
    def last() -> tuple[float, int, int, int]:
        """Duty, C3, C4 and POS of the last whole row."""
        rows = [row for row in rows_of(Path("run.csv")) if row.count(",") == 8] if Path("run.csv").exists() else []
        if len(rows) < 2:
            return math.nan, -1, -1, -1
        fields = rows[-2].split(",")
        return float(fields[1]), int(fields[2]), int(fields[3]), int(fields[4])

    def drives(self, duty_pct: float) -> bool:
        return abs(self.last()[0] - duty_pct) <= 2.0

    def braked(self) -> bool:
        return self.last()[:3] == (0.0, 1, 1)

    def display(self) -> int:
        """The process of the window or the web server."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        found = [c for c in children if b"spawn_main" in Path(f"/proc/{c}/cmdline").read_bytes()]
        return int(found[0])

    def ended(self) -> tuple[int, str, Log]:
        """Exit code, standard error without traffic, and the log; the last report sent was a brake."""
        code = self.process.wait(timeout=240)
        lines = self.errors.read_text().splitlines()
        sent = [line.partition("64: ")[2] for line in lines if line.startswith("fiohost.traffic: out")]
        assert sent[-1] == "00 00 00 00 01 01"
        log = Log.read("run.csv")
        assert log.dropped == ()
        return code, "\n".join(self.said()), log


@contextmanager
def running(*arguments: str, environment: dict[str, str] | None = None) -> Iterator[Run]:
    run = Run(*arguments, environment=environment)
    try:
        yield run
    finally:
        if run.process.poll() is None:
            run.process.kill()
        run.process.wait()


def drive_by_hand(run: Run, click: Callable[[float, float], None]) -> None:
    """Slider, brake, emergency stop and its release, by the mouse."""

    def pressed(what: Callable[[], bool], *places: tuple[float, float]) -> None:
        """Click until that comes of it: a window that is not drawn yet takes no mouse."""
        again = 0.0

        def asked() -> bool:
            nonlocal again
            if what():
                return True
            if time.monotonic() >= again:
                for place in places:
                    click(*place)
                again = time.monotonic() + 10.0
            return False

        run.until(asked)

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
        drive_by_hand(run, lambda x, y: screen.click(window, x, y))
        screen.close(window)
        code, _, log = run.ended()
        assert (code, log.metadata["ending"]) == (0, "complete")
        assert log.duty_pct[-1] == pytest.approx(-30.0, abs=2.0)


def test_in_a_browser_the_mouse_drives_brakes_and_stops_and_leaving_brakes(tmp_path: Path) -> None:
    needed("chromium")
    with running("--web", "--port", "0") as run, Chromium(tmp_path / "profile") as browser:
        browser.open(run.where().removeprefix("at "))
        run.until(lambda: (browser.value("(document.querySelector('canvas') || {width: 0}).width") or 0) >= SIZE_PX[0])
        drive_by_hand(run, browser.click)
        browser.close_tab()
        run.until(run.braked)
        run.process.send_signal(signal.SIGINT)
        code, said, log = run.ended()
        assert code == 130, said
        assert log.metadata["ending"] == "stopped by Ctrl-C"


def test_where_no_window_can_be_opened_that_is_said_and_the_browser_named() -> None:
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND")}
    done = subprocess.run([*FIOHOST, "panel"], env=environment, capture_output=True, text=True, timeout=240)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1
    assert "no window can be opened" in done.stderr
    assert "--web" in done.stderr


def press(fraction: float) -> str:
    """A click on the slider as matplotlib's script sends it."""
    at = {"x": slider_x(fraction) * SIZE_PX[0], "y": (1.0 - SLIDER_Y) * SIZE_PX[1]}
    return json.dumps({"type": "button_press", **at, "button": 0, "buttons": 1, "modifiers": []})


async def refuses(where: str, **headers: str) -> bool:
    try:
        await AsyncHTTPClient().fetch(where, headers=headers)
    except HTTPClientError as exc:
        return exc.code == 403
    return False


async def arrives(what: Callable[[], bool]) -> None:
    for _ in range(6000):
        if what():
            return
        await asyncio.sleep(0.02)
    raise AssertionError("it did not come")


class Tab:
    """A browser's socket: answers pings, and paints what comes until it is frozen."""

    frozen = False

    def __init__(self, connection: Any) -> None:
        self._connection = connection
        self.send, self.close = connection.write_message, connection.close
        self._reads = asyncio.ensure_future(self._read())

    async def _read(self) -> None:
        while (came := await self._connection.read_message()) is not None:
            if isinstance(came, bytes) and not self.frozen:
                await self.send('{"type": "ack"}')


async def joins(run: Run) -> Tab:
    where = run.where().removeprefix("at ")
    tab = Tab(await websocket_connect(where.replace("http://", "ws://").replace("/?", "/socket?")))
    await tab.send('{"type": "refresh"}')
    return tab


def test_a_browser_that_paints_nothing_is_braked_for_though_its_socket_lives() -> None:
    """The pictures are the dead man's switch: pings are answered by a frozen page too."""

    async def session(run: Run) -> None:
        browser = await joins(run)
        await browser.send(press(60.0))
        await arrives(lambda: run.drives(60.0))
        browser.frozen = True
        await arrives(run.braked)
        browser.frozen = False
        await browser.send('{"type": "ack"}')
        await browser.send(press(-40.0))
        await arrives(lambda: run.drives(-40.0))  # back, and asked for
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
            await first.send(json.dumps({"type": "key_press", "key": key}))
        for _ in range(3000):
            await second.send(press(80.0))
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

    with running("--web", "--port", "0", "--away", "30") as run:
        asyncio.run(session(run))
        code, said, log = run.ended()
        assert code == 130
        assert "Traceback" not in said
    assert log.duty_pct.max() < 60.0


@pytest.mark.parametrize("bind", ["127.0.0.1", "0.0.0.0"])
def test_names_of_others_and_addresses_without_the_token_are_refused(bind: str) -> None:
    async def session(run: Run) -> None:
        where = run.where().removeprefix("at ").replace(socket.gethostname(), "127.0.0.1")
        plain, _, token = where.partition("?")
        assert len(token) > 20
        assert await refuses(where, Host="rebound.example")
        assert await refuses(plain)
        assert await refuses(plain + "?token=" + "x" * 22)
        assert await refuses(plain + "mpl.js")
        assert not await refuses(where)
        for bad in (plain + "socket", where.replace("/?", "/socket?")):
            headers = {"Host": "rebound.example"} if "token" in bad else {}
            with pytest.raises(HTTPClientError, match="403"):
                await websocket_connect(HTTPRequest(bad.replace("http://", "ws://"), headers=headers))
        run.process.send_signal(signal.SIGINT)

    with running("--web", "--port", "0", "--bind", bind) as run:
        asyncio.run(session(run))
        assert run.process.wait(240) == 130


@pytest.mark.parametrize("bind", ["127.0.0.1/../", "no such name", "x" * 300, "\x1b[2J", "203.0.113.7"])
def test_an_address_that_is_none_is_refused_in_one_sentence(bind: str) -> None:
    done = subprocess.run([*FIOHOST, "panel", "--web", "--bind", bind], capture_output=True, text=True, timeout=240)
    assert done.returncode == 1
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert "cannot serve the panel at" in done.stderr


def test_a_board_that_goes_silent_leaves_no_traceback(tmp_path: Path) -> None:
    with PtyBoard() as board, running("--web", "--port", "0", "--target", f"serial:{board.target}",
                                      "--guard", "gap_s=20") as run:  # fmt: skip
        run.until(run.braked)
        board.unplug()
        assert run.process.wait(240) == 1
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
        await browser.send(press(60.0))
        await arrives(lambda: run.drives(60.0))
        browser.close()
        await arrives(run.braked)  # the last has gone
        again = await joins(run)
        await again.send(press(-40.0))
        await arrives(lambda: run.drives(-40.0))
        os.kill(run.display(), signal.SIGKILL)

    with running("--web", "--port", "0", "--away", "20") as run:
        asyncio.run(session(run))
        code, said, log = run.ended()
    assert code == 1
    assert said.splitlines()[0] == "fiohost: the panel died and the motor was braked"
    assert log.duty_pct[-1] == pytest.approx(-40.0, abs=2.0)
    assert "the panel died" in log.metadata["ending"]


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
