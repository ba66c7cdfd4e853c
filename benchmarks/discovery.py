"""How often discovery is right: random plants, effects and sizes from the board, rates with their counts and bounds.

    python benchmarks/discovery.py --out results.jsonl                 the whole plan, hours; resumes where it stopped
    python benchmarks/discovery.py --out results.jsonl --minutes 30       as much of it as that
    python benchmarks/discovery.py --smoke                                 60 fixed cases
    python benchmarks/discovery.py --table results.jsonl [--page FILE]     rates, or the page

Seeds are fresh from the system unless ``--seed`` is given, and recorded. The truth comes from ``firmware_model``
through the wire; the engine sees logs only.
"""

from __future__ import annotations

import argparse
import json
import random
import secrets
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from discovery_cases import EFFECTS
from discovery_rates import page, summary, table
from discovery_run import Row, Task, run_task, same

SMOKE_SEED = 20240601


def plan(counts: dict[str, int], rng: random.Random) -> list[Task]:
    """Tasks in a random order: every effect ``clear`` and ``faint`` times, and so many pairs, outsiders and none."""
    names = sorted(EFFECTS)
    draw = lambda: rng.randrange(2**31)  # noqa: E731
    tasks = [Task(kind, (n,), draw()) for kind in ("clear", "faint") for n in names for _ in range(counts[kind])]
    tasks += [Task("none", (), draw()) for _ in range(counts["none"])]
    tasks += [Task("outside", (rng.choice(names),), draw()) for _ in range(counts["outside"])]
    while sum(t.kind == "pair" for t in tasks) < counts["pair"]:
        first, second = rng.sample(names, 2)
        if not same(first, second):
            tasks.append(Task("pair", (first, second), draw()))
    rng.shuffle(tasks)
    return tasks


def done(path: Path) -> list[Row]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def run(tasks: list[Task], out: Path, jobs: int, minutes: float) -> None:
    """Run what is not there yet, a row a line, until all is done or time is up."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    over = time.monotonic() + 60.0 * minutes
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns) as bar, ProcessPoolExecutor(jobs) as pool, out.open("a") as file:
        shown = bar.add_task("discovery", total=len(tasks))
        waiting = {}
        queue = iter(tasks)
        while True:
            while len(waiting) < 2 * jobs and time.monotonic() < over and (task := next(queue, None)):
                waiting[pool.submit(run_task, task)] = task
            if not waiting:
                break
            for finished in as_completed(waiting):
                task = waiting.pop(finished)
                try:
                    row = finished.result()
                except Exception as exc:
                    row = {"key": task.key, "kind": task.kind, "truth": list(task.names), "error": repr(exc)}
                file.write(json.dumps(row, default=str) + "\n")
                file.flush()
                bar.update(shown, advance=1)
                bar.print(summary(row), highlight=False)
                break


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for kind, count in (("clear", 8), ("faint", 4), ("none", 300), ("pair", 40), ("outside", 20)):
        parser.add_argument(f"--{kind}", type=int, default=count, help="cases, of each effect for clear and faint")
    parser.add_argument("--out", type=Path, default=Path("discovery.jsonl"))
    parser.add_argument("--seed", type=int)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--smoke", action="store_true")
    parser.add_argument("--table", type=Path)
    parser.add_argument("--page", type=Path)
    options = parser.parse_args()
    if options.table:
        rows = done(options.table)
        if options.page:
            options.page.write_text(page(rows), encoding="utf-8")
        print(table(rows))
        return
    counts = {kind: getattr(options, kind) for kind in ("clear", "faint", "none", "pair", "outside")}
    earlier = done(options.out)
    seed = options.seed
    if options.smoke:
        counts, seed = {"clear": 1, "faint": 0, "none": 20, "pair": 5, "outside": 4}, SMOKE_SEED
    elif seed is None:
        seed = next((r["plan"] for r in earlier if "plan" in r), secrets.randbelow(2**31))
    if not any("plan" in r for r in earlier):
        with options.out.open("a") as file:
            file.write(json.dumps({"plan": seed, "counts": counts}) + "\n")
    finished = {r["key"] for r in earlier if "key" in r}
    tasks = [t for t in plan(counts, random.Random(seed)) if t.key not in finished]
    run(tasks, options.out, options.jobs, options.minutes)
    print(table(done(options.out)))


if __name__ == "__main__":
    main()
