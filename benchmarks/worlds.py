"""How often discovery is right on benches that do not repeat themselves: noise, random torque, lost rows, wrong stamps.

    python benchmarks/worlds.py --out results.jsonl                    the whole plan, days; resumes where it stopped
    python benchmarks/worlds.py --small --minutes 15 --out results.jsonl   short runs, a few cases a world, in minutes
    python benchmarks/worlds.py --short --clear 1 --sample 10 --none 20 --out results.jsonl   short runs, so many cases
    python benchmarks/worlds.py --world "sensor 1 count" ...              some of the worlds
    python benchmarks/worlds.py --oracle results.jsonl                 adds to rows what the true structure would gain
    python benchmarks/worlds.py --table results.jsonl [--page docs/worlds.md]

Plants, effects, sizes and noise are drawn; the seed is fresh from the system unless ``--seed`` is given, and recorded.
"""

from __future__ import annotations

import argparse
import json
import random
import secrets
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).parent))

from discovery import run
from discovery_cases import EFFECTS
from discovery_run import Row, same
from rows import filled, programs, read
from worlds_logs import WORLDS
from worlds_run import WorldTask, ask_oracle, drawable, right, rightly_judged, run_world

Test = Callable[[Row], bool]
# Rows of the same plan by the program that judged by counts alone.
BEFORE = Path(__file__).parent / "results" / "worlds_before.jsonl"
# The row of the table for all of them together.
ALL = "all worlds"
# Interval coverage counts parameters whose truth is a plain number.
NOT_COUNTED = (".order", ".levels", "time_s", ".side", ".which")


def plan(worlds: Sequence[str], clear: int, none: int, sample: int, short: bool, seed: int) -> list[WorldTask]:
    """Tasks in a random order: in each world ``clear`` plants of every effect, or of ``sample`` drawn effects, and
    ``none`` that lack nothing.
    """
    tasks = []
    for world in worlds:
        rng = random.Random(f"{world} {seed}")
        names = [n for n in sorted(EFFECTS) if drawable(world, n)]
        names = rng.sample(names, min(sample, len(names))) if sample else names
        tasks += [WorldTask(world, (n,), rng.randrange(2**31), short) for n in names for _ in range(clear)]
        tasks += [WorldTask(world, (), rng.randrange(2**31), short) for _ in range(none)]
    random.Random(seed).shuffle(tasks)
    return tasks


def bounds(hits: int, total: int) -> str:
    """Counts and exact 95 % bounds of a rate (Clopper and Pearson 1934)."""
    if total == 0:
        return "none"
    low = float(beta.ppf(0.025, hits, total - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, total - hits)) if hits < total else 1.0
    return f"{hits} of {total} ({100 * low:.0f} to {100 * high:.0f} %)"


def counted(rows: Sequence[Row], test: Test) -> str:
    return bounds(sum(map(test, rows)), len(rows))


def covered(rows: Sequence[Row]) -> str:
    """How many 95 % intervals hold the truth, where the first name is right and the only one, or nothing lacks."""
    hits = total = 0
    for row in rows:
        if set(row["named"]) != set(row["truth"]):
            continue
        for key, interval in row["intervals"].items():
            group, _, short = key.partition(".")
            truth = row["reduced"].get(group, {}).get(short)
            if isinstance(truth, (int, float)) and not key.endswith(NOT_COUNTED) and "phase" not in short:
                total += 1
                hits += interval[0] <= truth <= interval[1]
    return bounds(hits, total)


def noise_covered(rows: Sequence[Row]) -> str:
    """How many 95 % intervals of the noise hold the truth; those of a correlation time only where there is a torque."""
    hits = total = 0
    for row in rows:
        for key, truth in row["true_noise"].items():
            told = (row.get("noise") or {}).get(key)
            if told is None or (key == "torque_time_s" and not row["true_noise"]["torque_rms_pct"]):
                continue
            total += 1
            hits += told["ci95"][0] <= truth <= told["ci95"][1]
    return bounds(hits, total)


def summary(row: Row) -> str:
    """One case in a line."""
    if "error" in row:
        return f"{row['key']}: {row['error']}"
    if not row["drawn"]:
        return f"{row['key']}: no plant of this size was drawn"
    seen = ""
    if row.get("oracle"):
        seen = f"; the truth gains {row['oracle']['gain']:.0f}, chance {row['oracle']['chance']:.0f}"
    told = f" to {row['explained_to']}" if row.get("explained_to") else ""
    return (
        f"{row['key']}: {row['verdict']}{told}, {'+'.join(row['named']) or 'nothing'}{seen}; {row['cpu_s']:.0f} CPU s"
    )


def seen(row: Row) -> bool:
    """Whether the oracle says that the effect can be seen; without an oracle, all are taken for it."""
    oracle = row.get("oracle")
    return oracle is None or oracle["gain"] >= 3.0 * oracle["chance"]


def others_named(row: Row) -> bool:
    """Whether something is named that is not there, beside what is."""
    return any(not any(same(name, t) for t in row["truth"]) for name in row["named"])


def table(rows: Sequence[Row]) -> str:
    """Rates by world and of all as Markdown, and every case that went wrong."""
    drawn = [r for r in rows if r.get("drawn")]
    head = (
        "world", "false claims", "first name right", "others named beside", "verdict right", "intervals",
        "noise's intervals", "CPU s",
    )  # fmt: skip
    lines = [f"| {' | '.join(head)} |", "|---" * len(head) + "|"]
    for name in (*(w.name for w in WORLDS), ALL):
        part = [r for r in drawn if name in (r["world"], ALL)]
        if not part:
            continue
        none, clear = [r for r in part if not r["truth"]], [r for r in part if r["truth"] and seen(r)]
        cpu = sorted(r["cpu_s"] for r in part)
        cells = [
            name, counted(none, lambda r: bool(r["named"])), counted(clear, right),
            counted([r for r in clear if right(r)], others_named), counted([*none, *clear], rightly_judged),
            covered(part), noise_covered(part), f"{cpu[len(cpu) // 2]:.0f}",
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    wrong = [
        r for r in rows if "error" in r or (r.get("drawn") and (bool(r["named"]) if not r["truth"] else not right(r)))
    ]
    return "\n".join([*lines, "", "Not right:", "", *(f"- {summary(r)}" for r in wrong)])


def page(rows: Sequence[Row]) -> str:
    """docs/worlds.md from its template."""
    seeds = ", ".join(str(r["plan"]) for r in rows if "plan" in r)
    cases = [r for r in rows if "key" in r]
    template = Path(__file__).with_name("worlds.template.md")
    before = [r for r in read(BEFORE) if "key" in r]
    return filled(
        template,
        table=table(cases),
        seeds=seeds,
        count=str(len(cases)),
        programs=programs(cases),
        before=table(before),
        before_count=str(len(before)),
        before_programs=programs(before),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clear", type=int, default=4, help="plants of each effect in each world")
    parser.add_argument("--none", type=int, default=100, help="plants that lack nothing in each world")
    parser.add_argument("--sample", type=int, default=0, help="only so many drawn effects in each world")
    parser.add_argument("--short", action="store_true", help="short runs")
    parser.add_argument("--small", action="store_true", help="short runs; 4 drawn effects and 3 that lack nothing")
    parser.add_argument("--world", action="append", choices=[w.name for w in WORLDS], help="these worlds only")
    parser.add_argument("--out", type=Path, default=Path("worlds.jsonl"))
    parser.add_argument("--seed", type=int)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    parser.add_argument("--oracle", type=Path, help="rows with an effect that no oracle was asked about are")
    parser.add_argument("--table", type=Path)
    parser.add_argument("--page", type=Path)
    options = parser.parse_args()
    if options.oracle:
        rows = read(options.oracle)
        over = time.monotonic() + 60.0 * options.minutes
        for i, row in enumerate(rows):
            if row.get("drawn") and row["truth"] and "oracle" not in row and time.monotonic() < over:
                rows[i] = ask_oracle(row)
                print(summary(rows[i]), flush=True)
                options.oracle.write_text("".join(json.dumps(r, default=str) + "\n" for r in rows), encoding="utf-8")
        return
    if options.table:
        rows = read(options.table)
        if options.page:
            options.page.write_text(page(rows), encoding="utf-8")
        print(table([r for r in rows if "key" in r]))
        return
    earlier = read(options.out)
    seed = options.seed
    if seed is None:
        seed = next((r["plan"] for r in earlier if "plan" in r), secrets.randbelow(2**31))
    if not any(r.get("plan") == seed for r in earlier):
        with options.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"plan": seed}) + "\n")
    worlds = options.world or [w.name for w in WORLDS]
    counts = (1, 3, 4) if options.small else (options.clear, options.none, options.sample)
    finished = {r["key"] for r in earlier if "key" in r}
    tasks = [t for t in plan(worlds, *counts, options.small or options.short, seed) if t.key not in finished]
    with options.out.open("a", encoding="utf-8") as file:
        for row in run(tasks, options.jobs, options.minutes, work=run_world, told=summary):
            file.write(json.dumps(row, default=str) + "\n")
            file.flush()
    print(table([r for r in read(options.out) if "key" in r]))


if __name__ == "__main__":
    main()
