"""Between the bench and what shows it: JSON messages over a pipe, and the program that the bench loop asks.

The display asks (``{"act": NAME, "value": X}``, and ``{"frame": N}`` about twelve times a second); the bench answers
each frame with the readings since the last. So frames are the display's sign of life, and the bench never sends what
nobody reads, nor waits for anyone.
"""

from __future__ import annotations

import json
import time
from collections import deque
from contextlib import suppress
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from fiohost.bench.loop import Bench, Tick
from fiohost.bench.program import Answer
from fiohost.errors import FiohostError
from fiohost.panel.controls import Controls
from fiohost.panel.recorder import Recorder

HANG_S = 2.0  # a display that asks for no frame so long is taken for dead, and the motor is braked
READING_S = 0.02  # between two readings that are shown
GOODBYE_S = 3.0  # that a closed display waits for the bench to have heard it
MAX_MESSAGE_BYTES = 500
MAX_MESSAGES_A_TICK = 20
MAX_READINGS = 100  # in one answer: small enough never to fill a pipe


class Reading(NamedTuple):
    """One tick as it is shown."""

    time_s: float
    duty_pct: float
    c3: int
    c4: int
    pos: int
    direction: int
    angle_deg: float
    ref_deg: float | None = None


@dataclass(frozen=True)
class Facts:
    """What a display must know before it begins."""

    target: str
    counts_per_rev: int
    sample_time_s: float
    limit_pct: float
    log: str


@dataclass(frozen=True)
class News:
    """The answer to one frame."""

    readings: list[Reading]
    duty_pct: float
    mode: str
    stopped: bool
    handled: int  # actions so far: an older answer must not move a slider back
    note: str
    ticks: int
    late: int
    mean_ms: float
    worst_ms: float
    missed: int  # ticks without a reading
    doing: str = "hand"  # or source, or loop
    recording: str = ""  # the log that is being written by the record button
    recorded: int = 0  # its rows

    @classmethod
    def parse(cls, text: bytes) -> News:
        fields = json.loads(text)
        return cls(**fields | {"readings": [Reading(*row) for row in fields["readings"]]})


class PanelProgram:
    """Asked by the bench loop at each tick; listens to the display in between. Also the loop's progress."""

    def __init__(self, bench: Bench, display: Connection[Any, Any], died: str) -> None:
        self.controls = Controls(bench.profile.limit_duty_pct, sample_time_s=bench.sample_time_s)
        self.recorder = Recorder(Path.cwd(), bench.head(), behind=not bench.transport.lock_step)
        self.note = ""
        self._bench = bench
        self._display = display
        self._died = died
        self._closed = False
        self._handled = 0
        self._seen_s: float | None = None
        self._readings: deque[Reading] = deque(maxlen=MAX_READINGS)

    def step(self, k: int, angle_deg: float) -> Answer | None:
        """Raises FiohostError where the display died."""
        now_s = time.monotonic()
        try:
            for _ in range(MAX_MESSAGES_A_TICK):
                if self._closed or not self._display.poll():
                    break
                self._take(self._display.recv_bytes(MAX_MESSAGE_BYTES), now_s)
        except (OSError, EOFError, ValueError) as exc:
            raise FiohostError(self._died) from exc
        if self._closed:
            return None
        if self._seen_s is None:
            self._seen_s = now_s
        elif now_s - self._seen_s > HANG_S and self.controls.drives:
            self.controls.act("brake")
            self.note = f"the display did not answer for {HANG_S:g} s: braked"
        return self.controls.answer(k * self._bench.sample_time_s, angle_deg)

    def __call__(self, tick: Tick) -> None:
        command = tick.command
        self._readings.append(
            Reading(
                tick.time_s,
                command.duty_pct,
                command.c3,
                command.c4,
                tick.pos,
                tick.direction,
                tick.angle_deg,
                tick.ref_deg,
            )
        )

    def _take(self, text: bytes, now_s: float) -> None:
        """One message. Raises ValueError where it is none of ours: then the display is out of its mind."""
        message = json.loads(text)
        self._seen_s = now_s
        match message:
            case {"frame": True}:
                self._display.send_bytes(json.dumps(asdict(self._news())).encode())
            case {"act": str(name), **rest}:
                self._handled += 1
                try:
                    self.note = str(rest.get("why", ""))
                    if name == "record":
                        self._keep(rest.get("value") is True)
                    else:
                        self.controls.act(name, rest.get("value"))
                except FiohostError as exc:
                    self.note = f"refused: {exc}"
            case {"closed": True}:
                self._closed = True
            case _:
                raise ValueError(f"unknown message {message!r}")

    def _keep(self, wanted: bool) -> None:
        """The record button."""
        recorder = self.recorder
        if wanted:
            self.note = f"recording {recorder.start().name}"
        elif recorder.on and recorder.path is not None:
            recorder.stop()
            self.note = f"{recorder.path.name}: {recorder.rows} rows"

    def _news(self) -> News:
        readings = [self._readings.popleft() for _ in range(len(self._readings))]  # more may come meanwhile
        statistics = self._bench.statistics
        return News(
            readings=readings,
            duty_pct=self.controls.command.duty_pct,
            mode=self.controls.command.mode_name,
            stopped=self.controls.stopped,
            handled=self._handled,
            note=self.recorder.problem or self.note,
            ticks=statistics.ticks,
            late=statistics.late,
            mean_ms=1e3 * statistics.mean_s,
            worst_ms=1e3 * statistics.worst_s,
            missed=statistics.silent + statistics.refused,
            doing=self.controls.doing,
            recording=self.recorder.path.name if self.recorder.on and self.recorder.path else "",
            recorded=self.recorder.rows,
        )


class Remote:
    """The display's end of the link."""

    def __init__(self, bench: Connection[Any, Any]) -> None:
        self._bench = bench
        self._asked = False
        self.actions = 0

    def act(self, name: str, value: float | bool | dict[str, Any] | None = None, why: str = "") -> None:
        self.actions += 1
        with suppress(EOFError):  # news() says so too
            self._send({"act": name, "value": value, "why": why})

    def news(self) -> News | None:
        """What came since the last call, and a question for more. Raises EOFError once the bench has ended."""
        found = None
        try:
            while self._bench.poll():
                found = News.parse(self._bench.recv_bytes())
                self._asked = False
        except OSError as exc:  # it ended with something of ours unread
            raise EOFError("the bench has ended") from exc
        if not self._asked:
            self._send({"frame": True})
            self._asked = True
        return found

    def ready(self, where: str = "") -> None:
        """Say that the display stands, so that the bench may begin."""
        self._send({"ready": where})

    def failed(self, why: str) -> None:
        self._send({"failed": why})

    def closed(self) -> None:
        """Say that a person has closed the display: the session ends well.

        Stays until the bench has ended the link: leaving an answer unread, or the bench one that nobody can take, would
        break the link before it is heard.
        """
        self._send({"closed": True})
        with suppress(EOFError, OSError):
            while self._bench.poll(GOODBYE_S):
                self._bench.recv_bytes()

    def _send(self, message: dict[str, Any]) -> None:
        try:
            self._bench.send_bytes(json.dumps(message).encode())
        except OSError as exc:
            raise EOFError("the bench has ended") from exc
