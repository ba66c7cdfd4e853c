"""Work done behind the back of whoever must not wait: writing to disks, terminals and pipes that may not answer.

One thread takes items from a bounded queue, in their order. Handing one over never waits: where the queue is full it is
refused, and the caller says what that means. The thread does not keep the process alive.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from typing import Generic, TypeVar

Item = TypeVar("Item")

_STEP_S = 0.05  # of waiting: in between signals are heard


class Background(Generic[Item]):
    """Does *work* on each item in a thread of its own, with at most *most* items waiting.

    ``problem`` is what *work* has raised; after it nothing more is done.
    """

    def __init__(self, work: Callable[[Item], None], most: int, name: str) -> None:
        self._work, self._most = work, most
        self._queue: SimpleQueue[tuple[Item] | None] = SimpleQueue()
        self._taken = 0  # each counter has one writer
        self.done = 0
        self._closed = False
        self.problem: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=f"fiohost-{name}", daemon=True)
        self._thread.start()

    def put(self, item: Item) -> bool:
        """Hand one item over; False where too many wait, and it was not taken."""
        if self._taken - self.done >= self._most:
            return False
        self._taken += 1
        self._queue.put((item,))
        return True

    @property
    def waiting(self) -> int:
        """Items that were taken and are not done."""
        return self._taken - self.done

    def close(self, limit_s: float | None = None) -> bool:
        """No more items; wait until all are done, at most *limit_s*: whether they are. Harmless when done twice."""
        if not self._closed:
            self._closed = True
            self._queue.put(None)
        return self._wait(lambda: not self._thread.is_alive(), limit_s)

    def flush(self, limit_s: float) -> bool:
        """Wait until all that was handed over is done, at most *limit_s*: whether it is."""
        return self._wait(lambda: not self.waiting or not self._thread.is_alive(), limit_s)

    def _wait(self, is_over: Callable[[], bool], limit_s: float | None) -> bool:
        deadline_s = None if limit_s is None else time.monotonic() + limit_s
        step_s = 1e-4
        while not is_over():
            if deadline_s is not None and time.monotonic() >= deadline_s:
                return False
            self._thread.join(step_s)
            step_s = min(2.0 * step_s, _STEP_S)
        return True

    def _run(self) -> None:
        while (entry := self._queue.get()) is not None:
            if self.problem is None:
                try:
                    self._work(entry[0])
                except BaseException as exc:
                    self.problem = exc
            self.done += 1
