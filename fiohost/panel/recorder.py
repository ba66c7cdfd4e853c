"""The record button: a log from here to there, beside the session's own."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from pathlib import Path

from fiohost.bench.writer import LogWriter
from fiohost.errors import FiohostError


class Recorder:
    """Takes every row of a session and keeps those between ``start`` and ``stop`` in a log of its own.

    A disk must not hold up the loop: with *behind* rows are written by a thread, and logs are always closed by one.
    """

    def __init__(self, folder: Path, head: Mapping[str, str], *, behind: bool) -> None:
        self.path: Path | None = None
        self.rows = 0
        self.problem = ""
        self._folder, self._head, self._behind = folder, head, behind
        self._writer: LogWriter | None = None
        self._from_s: float | None = None
        self._closing: list[threading.Thread] = []

    @property
    def on(self) -> bool:
        return self._writer is not None

    def start(self) -> Path:
        """Begin a log under the first free name. Raises FiohostError where it cannot be written."""
        if self._writer is not None:
            assert self.path is not None
            return self.path
        stem = time.strftime("panel-%Y%m%d-%H%M%S")
        names = (f"{stem}{'' if i == 1 else f'-{i}'}.csv" for i in range(1, 1000))
        path = next(self._folder / name for name in names if not (self._folder / name).exists())
        self._writer = LogWriter(path, {**self._head, "experiment": "panel"}, behind=self._behind)
        self.path, self.rows, self._from_s, self.problem = path, 0, None, ""
        return path

    def stop(self, ending: str = "complete") -> None:
        """End the log that is being written, if any."""
        writer, self._writer = self._writer, None
        if writer is not None:
            thread = threading.Thread(target=self._close, args=(writer, ending), name="record-end")
            thread.start()
            self._closing.append(thread)

    def row(
        self, time_s: float, duty_pct: float, c3: int, c4: int, pos: int, direction: int, ref_deg: float | None = None,
        angle_deg: float | None = None, host_time_s: float | None = None,
    ) -> None:  # fmt: skip
        """One tick of the session; what cannot be written ends the record, not the session."""
        if self._writer is None:
            return
        if self._from_s is None:
            self._from_s = time_s
        try:
            self._writer.row(time_s - self._from_s, duty_pct, c3, c4, pos, direction, ref_deg, angle_deg)
            self.rows += 1
        except FiohostError as exc:
            self.problem = str(exc)
            self.stop(f"stopped: {exc}")

    def close(self) -> None:
        """End what is being written and wait until it is."""
        self.stop()
        for thread in self._closing:
            thread.join()

    def _close(self, writer: LogWriter, ending: str) -> None:
        try:
            writer.close(ending)
        except FiohostError as exc:
            self.problem = str(exc)
