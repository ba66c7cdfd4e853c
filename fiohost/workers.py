"""Work shared among threads: the kernels run without the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from fiohost.errors import ConfigError

T = TypeVar("T")
R = TypeVar("R")

THREADS = "FIOHOST_THREADS"


def each(run: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """``[run(x) for x in items]`` on as many threads as there may be."""
    workers = min(len(items), threads())
    if workers < 2:
        return [run(x) for x in items]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(run, items))


def threads() -> int:
    """As many as the environment's ``FIOHOST_THREADS``, else as there are cores that this process may use.

    Raises ConfigError if that is not a number of threads.
    """
    told = os.environ.get(THREADS)
    if not told:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not (told.isascii() and told.isdecimal() and 1 <= int(told[:9]) <= 1024):
        raise ConfigError(f"the environment's {THREADS} is {told[:40]!r}: give a whole number from 1 to 1024")
    return int(told)


def one_thread() -> None:
    """Keep this process to one thread: where processes share the cores, more only get in each other's way."""
    os.environ[THREADS] = "1"
