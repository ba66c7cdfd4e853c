"""Rows of a benchmark: one JSON object a line, kept as they are done, from several processes at once."""

from __future__ import annotations

import argparse
import json
import secrets
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, TypeVar

Row = dict[str, Any]
Task = TypeVar("Task")


def commit() -> str:
    """The commit of the program that runs here."""
    asked = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True
    )
    return asked.stdout.strip() or "unknown"


def programs(rows: Sequence[Row]) -> str:
    """Which commits made the rows, in words: most of them first."""
    made = Counter(str(row["program"]) for row in rows if "program" in row)
    return ", ".join(f"{count} by {name}" for name, count in made.most_common())


def filled(template: Path, **told: str) -> str:
    """A page from its template, every ``{{key}}`` in it replaced."""
    text = template.read_text(encoding="utf-8")
    for key, words in told.items():
        text = text.replace(f"{{{{{key}}}}}", words)
    return text


def arguments(told: str, cases: int, of: str) -> argparse.ArgumentParser:
    """What such benchmarks are asked for; ``cases`` is how many ``of`` each there are unless said otherwise."""
    parser = argparse.ArgumentParser(description=told, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=cases, help=of)
    parser.add_argument("--seed", type=int, default=secrets.randbelow(2**31))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, help="rows of JSON; those that are there are kept")
    parser.add_argument("--page", type=Path)
    return parser


def read(path: Path | None, *keys: str) -> list[Row]:
    """The rows of a file, none where there is no file; leaves with a sentence where a line is no row with ``keys``."""
    if path is None or not path.exists():
        return []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as exc:
        sys.exit(f"{path} cannot be read: {exc}")
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
        except ValueError:
            row = None
        if not isinstance(row, dict) or not set(keys) <= set(row):
            sys.exit(f"{path}: line {number} is no row of this benchmark; mend or delete it")
        rows.append(row)
    return rows


def in_parallel(run: Callable[[Task], Row], tasks: Sequence[Task], jobs: int, out: Path | None) -> Iterator[Row]:
    """The row of each task as it is done, with the commit that made it, written to ``out`` at once."""
    program = commit()
    with ProcessPoolExecutor(jobs) as pool:
        for finished in as_completed([pool.submit(run, task) for task in tasks]):
            row = {**finished.result(), "program": program}
            if out:
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row, default=str) + "\n")
            yield row
