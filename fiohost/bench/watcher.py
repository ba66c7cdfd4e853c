"""Those who watch a run on a real board are told apart from the loop: a full terminal must not hold it up."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from fiohost.background import Background
from fiohost.bench.turns import Progress, Tick

MAX_WAITING = 100  # ticks that a watcher may be behind; what comes then is not shown
SWITCH_S = 0.0005  # the loop waits no longer than this for Python code of another thread


class Watcher:
    """Hands ticks on to *progress* in a thread of its own; what it raises is raised at the next tick."""

    def __init__(self, progress: Progress) -> None:
        self._behind: Background[Tick] = Background(progress, MAX_WAITING, "watcher")

    def __call__(self, tick: Tick) -> None:
        if self._behind.problem is not None:
            raise self._behind.problem
        self._behind.put(tick)

    def leave(self) -> None:
        """Show no more than what was handed on, and wait for nothing: the run has failed."""
        self._behind.close(0.0)

    def close(self) -> None:
        """Wait until all is shown, however long that takes: the motor is braked. Raises what *progress* has raised."""
        self._behind.close()
        if self._behind.problem is not None:
            raise self._behind.problem


@contextmanager
def quick_switches(is_on: bool) -> Iterator[None]:
    """Within it threads of Python give way to one another soon."""
    before = sys.getswitchinterval()
    if is_on:
        sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
