"""Work shared among threads: the kernels run without the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def each(run: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """``[run(x) for x in items]`` on all cores."""
    workers = min(len(items), os.cpu_count() or 1)
    if workers < 2:
        return [run(x) for x in items]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(run, items))
