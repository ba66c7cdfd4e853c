"""A watch in a process of its own, beside a bench whose loop must not wait for it: it follows the bench's log."""

from __future__ import annotations

import multiprocessing
import queue
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fiohost.bench.log import Log
from fiohost.errors import FiohostError
from fiohost.motor.model import Model
from fiohost.watch.detector import Event
from fiohost.watch.follow import GrowingLog, following
from fiohost.watch.watcher import Watch, watch_rows

IDLE_S = 3600.0
ENDS_WITHIN_S = 60.0


class WatchApart:
    """Follows a log that is being written; ``heard`` gives what it has said, ``end`` waits for the rest."""

    def __init__(self, path: Path, model: Model, learn_s: float, normal: Log | None) -> None:
        context = multiprocessing.get_context("spawn")
        self._said: Any = context.Queue()
        self._process = context.Process(target=_follow, args=(path, model, learn_s, normal, self._said), daemon=True)
        self._process.start()

    def heard(self) -> Iterator[Event | str]:
        """Events and sentences since the last call. Raises FiohostError where the watch failed."""
        while True:
            try:
                said = self._said.get_nowait()
            except queue.Empty:
                return
            if isinstance(said, FiohostError):
                raise said
            if not isinstance(said, dict):
                yield said

    def end(self) -> Iterator[Event | str | dict[str, Any]]:
        """All that is still said; the last is the result. The log has ended. Raises FiohostError."""
        while True:
            try:
                said = self._said.get(timeout=ENDS_WITHIN_S)
            except queue.Empty:
                if self._process.is_alive():
                    continue
                raise FiohostError("the watch ended without a result") from None
            if isinstance(said, FiohostError):
                raise said
            yield said
            if isinstance(said, dict):
                self._process.join()
                return

    def stop(self) -> None:
        """End the watch at once."""
        self._process.terminate()
        self._process.join()


def _follow(path: Path, model: Model, learn_s: float, normal: Log | None, said: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the bench ends the log, and with it this
    growing = GrowingLog(path)
    watch = Watch(model, growing.log, learn_s, [normal] if normal is not None else [], say=said.put)
    try:
        watch_rows(watch, following(growing, idle_s=IDLE_S), said.put)
        if watch.learned is None:
            watch.finish_learning()
        said.put(watch.to_json("the run ended"))
    except FiohostError as exc:
        said.put(exc)
    finally:
        growing.close()
