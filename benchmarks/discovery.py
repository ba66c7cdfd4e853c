"""How often discovery is right: random plants, effects and sizes from the board, rates with their counts and bounds.

    python benchmarks/discovery.py --out results.jsonl                 the whole plan, hours; resumes where it stopped
    python benchmarks/discovery.py --out results.jsonl --minutes 30       as much of it as that
    python benchmarks/discovery.py --out some.jsonl --effects duty_steps,gain_warm_up --none 20   of some effects
    python benchmarks/discovery.py --out results.jsonl --again backlash,fast_decay    rows with these in them once more
    python benchmarks/discovery.py --smoke                                 49 fixed cases on short runs, for the gate
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
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from discovery_cases import EFFECTS, YOUNG
from discovery_rates import BOUNDS, page, summary, table
from discovery_run import Row, Task, run_task, same
from rows import commit, read

from fiohost.workers import one_thread

# Cases of the smoke run: fixed by their seed, drawn once and not picked. Effects whose fits take minutes are left to
# the whole plan.
SLOW = frozenset({"fast_decay"})
SMOKE, SMOKE_SEED = {"clear": 1, "faint": 0, "none": 16, "pair": 3, "outside": 1}, 20240601


def plan(counts: dict[str, int], rng: random.Random, names: Sequence[str] | None = None) -> list[Task]:
    """Tasks in a random order: every effect ``clear`` and ``faint`` times, and so many pairs, outsiders and none.

    ``names`` are the effects to draw from (None: all).
    """
    names = sorted(EFFECTS) if names is None else names
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


def run(
    tasks: Sequence[Any],
    jobs: int,
    minutes: float = float("inf"),
    *,
    work: Callable[[Any], Row] = run_task,
    told: Callable[[Row], str] = summary,
) -> Iterator[Row]:
    """Rows as they are done, until all are or time is up; told in a line each, on a terminal under a bar."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    over, program = time.monotonic() + 60.0 * minutes, commit()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    alone = one_thread if jobs > 1 else None
    with (
        Progress(*columns, disable=not sys.stdout.isatty()) as bar,
        ProcessPoolExecutor(jobs, initializer=alone) as pool,
    ):
        shown = bar.add_task("discovery", total=len(tasks))
        waiting = {}
        queue = iter(tasks)
        while True:
            while len(waiting) < 2 * jobs and time.monotonic() < over and (task := next(queue, None)):
                waiting[pool.submit(work, task)] = task
            if not waiting:
                break
            finished = next(as_completed(waiting))
            task = waiting.pop(finished)
            try:
                row = {**finished.result(), "program": program}
            except Exception as exc:
                row = {"key": task.key, "kind": task.kind, "truth": list(task.names), "error": repr(exc)}
            bar.update(shown, advance=1)
            bar.console.print(told(row), highlight=False, soft_wrap=True)
            yield row


def smoke(jobs: int) -> None:
    """Fixed cases on short experiments; leaves with the reasons where counts are worse than their bounds."""
    drawn = plan(SMOKE, random.Random(SMOKE_SEED), sorted(EFFECTS.keys() - YOUNG))
    tasks = [replace(task, short=True) for task in drawn if not SLOW & set(task.names)]
    rows = list(run(tasks, jobs))
    print(f"\n{table(rows)}\n")
    counted = [bound.counted(rows) for bound in BOUNDS]
    print("\n".join(text for _, text in counted))
    worse = [text for good, text in counted if not good] + [summary(r) for r in rows if "error" in r]
    if worse:
        sys.exit(f"discovery is worse than its bounds: {'; '.join(worse)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for kind, count in (("clear", 8), ("faint", 4), ("none", 300), ("pair", 40), ("outside", 20)):
        parser.add_argument(f"--{kind}", type=int, default=count, help="cases, of each effect for clear and faint")
    parser.add_argument("--out", type=Path, default=Path("discovery.jsonl"))
    parser.add_argument("--effects", help="draw from these alone, names with commas between")
    parser.add_argument("--again", help="replace the rows with one of these effects in them, whatever the new ones say")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--smoke", action="store_true")
    parser.add_argument("--table", type=Path)
    parser.add_argument("--page", type=Path)
    options = parser.parse_args()
    if options.table:
        rows = read(options.table)
        if options.page:
            options.page.write_text(page(rows), encoding="utf-8")
        print(table(rows))
        return
    if options.smoke:
        smoke(options.jobs)
        return
    counts = {kind: getattr(options, kind) for kind in ("clear", "faint", "none", "pair", "outside")}
    earlier = read(options.out)
    if options.again:
        anew = set(options.again.split(","))
        tasks = [Task.of(r) for r in earlier if anew & set(r.get("truth", ()))]
    else:
        begun = next((r for r in earlier if "plan" in r), {})
        names = options.effects.split(",") if options.effects else begun.get("effects", sorted(EFFECTS))
        if unknown := [n for n in names if n not in EFFECTS]:
            sys.exit(f"no draw of {', '.join(unknown)}; there are {', '.join(sorted(EFFECTS))}")
        seed = options.seed
        if seed is None:
            seed = begun.get("plan", secrets.randbelow(2**31))
        if not begun:
            earlier.append({"plan": seed, "counts": counts, "effects": names})
        finished = {r["key"] for r in earlier if "key" in r}
        tasks = [t for t in plan(counts, random.Random(seed), names) if t.key not in finished]
    rows = {r.get("key"): r for r in earlier}
    for row in run(tasks, options.jobs, options.minutes):
        rows[row["key"]] = row
        fresh = options.out.with_suffix(".part")
        fresh.write_text("".join(json.dumps(r, default=str) + "\n" for r in rows.values()))
        fresh.replace(options.out)
    print(table(read(options.out)))


if __name__ == "__main__":
    main()
