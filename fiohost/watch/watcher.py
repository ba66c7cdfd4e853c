"""The watch of one motor: rows go in, what there is to say comes out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fiohost.bench.log import Log
from fiohost.estimation.record import Record, cut_windows, record_from_log
from fiohost.motor.model import Model
from fiohost.watch.detector import Detector, Event
from fiohost.watch.learn import Learned, learn
from fiohost.watch.settings import SETTINGS, WatchSettings

SCHEMA = "fiohost.watch/1"
WINDOW_S = 1.0


@dataclass
class Watch:
    """Learns what is normal from its first ``learn_s`` seconds (or from ``normal``, a log of it), then judges every
    window of one second as soon as it is whole. ``log_of`` makes a log of rows' lines.
    """

    model: Model
    log_of: Callable[[list[str]], Log]
    learn_s: float = SETTINGS.learn_s
    normal: Sequence[Log] = ()
    settings: WatchSettings = SETTINGS
    seed: int = 0
    say: Callable[[str], None] = lambda text: None
    learned: Learned | None = None
    events: list[Event] = field(default_factory=list)
    windows: int = 0
    last_s: float = 0.0
    _detector: Detector | None = None
    _times: list[float] = field(default_factory=list)
    _lines: list[str] = field(default_factory=list)
    _next_s: float | None = None

    def take(self, rows: Iterable[tuple[float, str]]) -> list[Event]:
        """More rows (time in s, line): what is said after them. Raises FiohostError."""
        for time_s, line in rows:
            if self._times and time_s <= self._times[-1]:
                continue
            self._times.append(time_s)
            self._lines.append(line)
        if not self._times:
            return []
        self.last_s = self._times[-1]
        if self._detector is None and not self._learn():
            return []
        found: list[Event] = []
        while (chunk := self._chunk()) is not None:
            found += self._judge(*chunk)
        self.events += found
        return found

    def _learn(self) -> bool:
        if self.normal:
            record = record_from_log(self.normal[0])
            self._next_s = self._times[0]
        elif self._times[-1] - self._times[0] >= self.learn_s:
            count = int(np.searchsorted(self._times, self._times[0] + self.learn_s))
            record = record_from_log(self.log_of(self._lines[:count]))
            self._next_s = self._times[count]
        else:
            return False
        self.say(f"learning what is normal from {record.seconds:.0f} s")
        self.learned = learn(record, self.model, self.settings, self.seed)
        self._detector = self.learned.detector(self.settings)
        return True

    def finish_learning(self) -> None:
        """Learn from what there is, where a log ended before. Raises DataError where that is too little."""
        if self._detector is None and self._times:
            self.learned = learn(record_from_log(self.log_of(self._lines)), self.model, self.settings, self.seed)

    def _chunk(self) -> tuple[int, int, int] | None:
        """First row of the lead, of the windows and after them; None while no window is whole."""
        assert self._next_s is not None
        whole = int((self._times[-1] - self._next_s) / WINDOW_S + 1e-6)
        if whole < 1:
            return None
        end_s = self._next_s + WINDOW_S * min(whole, self.settings.chunk_windows)
        lead, first, last = np.searchsorted(
            self._times, [self._next_s - self.settings.lead_s - 1e-9, self._next_s - 1e-9, end_s - 1e-9]
        )
        return int(lead), int(first), int(last)

    def _judge(self, lead: int, first: int, last: int) -> list[Event]:
        assert self.learned is not None
        assert self._detector is not None
        assert self._next_s is not None
        begin_s = self._times[lead]
        found: list[Event] = []
        end_s = self._next_s + WINDOW_S * max(1, round((self._times[last - 1] - self._next_s) / WINDOW_S))
        if last - first >= MOST_SPARSE and last - lead >= MOST_SPARSE:
            record = _led(record_from_log(self.log_of(self._lines[lead:last])), first - lead)
            for window in self.learned.evidence(record, begin_s, self._detector.at):
                self.windows += 1
                found += self._detector.push(window)
        self._next_s = max(end_s, self._next_s + WINDOW_S)
        keep = int(np.searchsorted(self._times, self._next_s - self.settings.lead_s - 1e-9))
        del self._times[:keep], self._lines[:keep]
        return found

    def to_json(self, ended: str) -> dict[str, Any]:
        normal = self.learned.normal if self.learned else None
        return {
            "schema": SCHEMA,
            "model": self.learned.model.expression if self.learned else self.model.expression,
            "parameters": dict(self.learned.model.values) if self.learned else {},
            "noise": None if self.learned is None else {
                "sensor_rms": self.learned.noise.sensor.value,
                "torque_rms_pct": self.learned.noise.torque_pct.value,
                "torque_time_s": self.learned.noise.torque_s.value,
            },
            "candidates": [c.name for c in self.learned.candidates] if self.learned else [],
            "threshold": self._detector.threshold if self._detector else None,
            "normal_power": normal.power if normal else None,
            "windows": self.windows,
            "last_s": self.last_s,
            "ended": ended,
            "alarms": sum(e.kind == "alarm" for e in self.events),
            "events": [e.to_json() for e in self.events],
        }  # fmt: skip


# Fewer rows than this in a window say nothing.
MOST_SPARSE = 20


def _led(record: Record, first: int) -> Record:
    """A record whose windows begin at its row ``first``: what is before tells commands and the start."""
    if first <= 0:
        return record
    times, segments = record.excitation.times_s, record.segments
    return replace(record, windows=first + cut_windows(times[first:], WINDOW_S, segments[first:]))


def watch_rows(watch: Watch, batches: Iterable[list[tuple[float, str]]], tell: Callable[[Event], None]) -> None:
    """Feed a watch until its rows end, telling each event at once."""
    for rows in batches:
        for event in watch.take(rows):
            tell(event)


def log_path_of(folder: Path) -> Path:
    """A name for the log of a bench that is watched and not kept."""
    return folder / "watched.csv"
