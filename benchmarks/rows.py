"""Rows of a benchmark: one JSON object a line, kept as they are done, from several processes at once."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, TypeVar

Row = dict[str, Any]
Task = TypeVar("Task")


def read(path: Path | None) -> list[Row]:
    """The rows of a file, none where there is no file; leaves with a sentence where a line is no row."""
    if path is None or not path.exists():
        return []
    rows = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            row = json.loads(line)
        except ValueError:
            row = None
        if not isinstance(row, dict):
            sys.exit(f"{path}: line {number} is no row of JSON; mend or delete it")
        rows.append(row)
    return rows


def in_parallel(run: Callable[[Task], Row], tasks: Sequence[Task], jobs: int, out: Path | None) -> Iterator[Row]:
    """The row of each task as it is done, written to ``out`` at once."""
    with ProcessPoolExecutor(jobs) as pool:
        for finished in as_completed([pool.submit(run, task) for task in tasks]):
            row = finished.result()
            if out:
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row, default=str) + "\n")
            yield row
