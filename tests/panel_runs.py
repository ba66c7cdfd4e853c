"""The panel's command in a process of its own, for tests: what it drives, says and leaves."""

from __future__ import annotations

import asyncio
import json
import math
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from boards import HANG_S, rows_of
from desktop import until
from test_cli_drive import FIOHOST
from tornado.httpclient import AsyncHTTPClient, HTTPClientError
from tornado.websocket import websocket_connect

from fiohost.bench.log import Log


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
        code = self.process.wait(timeout=HANG_S)
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


def press(duty_pct: float) -> str:
    """What the panel's page sends for a duty."""
    return json.dumps({"type": "act", "name": "duty", "value": duty_pct})


async def refuses(where: str, **headers: str) -> bool:
    try:
        await AsyncHTTPClient().fetch(where, headers=headers)
    except HTTPClientError as exc:
        return exc.code == 403
    return False


async def drives(run: Run, browser: Tab, duty_pct: float) -> None:
    """Ask for a duty until it is there: a browser that load keeps from painting is braked for, and may ask again."""
    for _ in range(600):
        await browser.send(press(duty_pct))
        for _ in range(100):
            if run.drives(duty_pct):
                return
            await asyncio.sleep(0.02)
    raise AssertionError("it did not drive")


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
            if '"news"' in came[:20] and not self.frozen:
                await self.send('{"type": "ack"}')


async def joins(run: Run) -> Tab:
    where = run.where().removeprefix("at ")
    return Tab(await websocket_connect(where.replace("http://", "ws://").replace("/?", "/socket?")))
