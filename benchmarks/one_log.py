"""How the diagnosis does with one log only: where data are poor, is what it is sure of right?

    python benchmarks/one_log.py --cases 10 --out rows.jsonl --page docs/one-log.md

One run of the closed-loop square wave of the lab, or of another experiment of the menu, on a drawn bench with one clear
effect or none. Seeds are fresh from the system unless ``--seed`` is given; rows that are there are kept.
"""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from discovery_cases import EFFECTS, make_case
from discovery_rates import classes, wilson
from discovery_run import CLEAR, DECLARED, clarity, same
from rows import Row, arguments, filled, in_parallel, programs, read

SQUARE = "square_170_190"
OTHERS = ("multisine", "multisine_fast", "pulses", "ramp_full", "random_steps", "reversals", "sine_slow", "sines_small",
          "staircase", "starts_slow", "steps_from_rest", "triangle_slow", "turns_slow")  # fmt: skip
TRIES = 8
TEMPLATE = Path(__file__).with_name("one_log.template.md")
Task = tuple[str, tuple[str, ...], int]


def run(task: Task) -> Row:
    """Draw until the effect is clear in this experiment, then diagnose; ``drawn`` is false where it never was."""
    from fiohost.bench.experiment import Experiment
    from fiohost.bench.loop import Bench
    from fiohost.circle.evidence import diagnose
    from fiohost.errors import FiohostError
    from fiohost.transport.profile import TargetProfile
    from fiohost.transport.simulated import SimulatedTransport
    from firmware_model import Board

    name, truth, first = task
    for seed in range(first, first + TRIES):
        board = Board(make_case(seed, truth).plant, seed=seed)
        try:
            with Bench(SimulatedTransport(board.step, "sim:sealed", "simulated"), TargetProfile.load()) as bench:
                log = bench.run(Experiment.load(name))
            if not truth or clarity([log]) >= CLEAR:
                break
        except FiohostError:  # a shaft that is held ends the run, one that never moves cannot be fitted
            continue
    else:
        return {"experiment": name, "truth": list(truth), "seed": first, "drawn": False}
    cpu = time.process_time()
    found = diagnose([log], [], DECLARED)
    return {
        "experiment": name,
        "truth": list(truth),
        "seed": seed,
        "drawn": True,
        "verdict": found.verdict,
        "named": [[s.effect, *s.indistinguishable_from] for s in found.steps],
        "cpu_s": time.process_time() - cpu,
    }


def sure(row: Row) -> bool:
    """One thing is named, with nothing beside it that it cannot be told from, and nothing is left."""
    return row["verdict"] == "explained" and len(row["named"]) == 1 and classes(row["named"][0]) == 1


def right(row: Row) -> bool:
    return bool(row["named"]) and same(row["named"][0][0], row["truth"][0])


def in_set(row: Row) -> bool:
    return any(same(name, row["truth"][0]) for names in row["named"] for name in names)


def table(rows: Sequence[Row]) -> str:
    missing = [[r for r in rows if not r["drawn"] and (r["experiment"] == SQUARE) is own] for own in (True, False)]
    rows = [r for r in rows if r["drawn"]]
    lines = ["| | square wave in closed loop | another experiment |", "|---|---|---|"]
    closed, opened = ([r for r in rows if (r["experiment"] == SQUARE) is own] for own in (True, False))

    def line(words: str, told: list[str]) -> None:
        lines.append(f"| {words} | {told[0]} | {told[1]} |")

    some = [[r for r in part if r["truth"]] for part in (closed, opened)]
    none = [[r for r in part if not r["truth"]] for part in (closed, opened)]
    certain = [[r for r in part if sure(r)] for part in some]
    line("first name right", [wilson(sum(map(right, p)), len(p)) for p in some])
    line("truth among the names", [wilson(sum(map(in_set, p)), len(p)) for p in some])
    line("sure: one name, nothing left", [wilson(len(c), len(p)) for c, p in zip(certain, some, strict=True)])
    line("right of those", [wilson(sum(map(right, c)), len(c)) for c in certain])
    sizes = [[classes(r["named"][0]) for r in p if r["named"]] for p in some]
    line("mean size of the first set", [f"{sum(s) / len(s):.1f}" if s else "none" for s in sizes])
    line("nothing missing: any effect claimed", [wilson(sum(bool(r["named"]) for r in p), len(p)) for p in none])
    line("effects that were never clear, left out", [str(len(m)) for m in missing])
    line("CPU seconds, median", [f"{sorted(r['cpu_s'] for r in p)[len(p) // 2]:.0f}" if p else "none" for p in some])
    return "\n".join(lines)


def mistakes(rows: Sequence[Row]) -> str:
    """What was named and is not there, case by case."""
    lines = []
    for row in rows:
        if row["drawn"] and row["named"] and not (row["truth"] and in_set(row)):
            told = " + ".join(" or ".join(names) for names in row["named"])
            truth = ", ".join(row["truth"]) or "nothing"
            lines.append(f"- {row['experiment']}, {truth} (seed {row['seed']}): {told}, {row['verdict']}")
    return "\n".join(lines) or "- none"


def plan(cases: int, rng: random.Random) -> list[Task]:
    """So many square waves and as many other experiments with an effect each, and half as many of both with none."""

    def effects() -> list[str]:
        names = [n for _ in range(1 + cases // len(EFFECTS)) for n in rng.sample(sorted(EFFECTS), len(EFFECTS))]
        return names[:cases]

    tasks: list[Task] = [(SQUARE, (name,), rng.randrange(2**31)) for name in effects()]
    tasks += [(rng.choice(OTHERS), (name,), rng.randrange(2**31)) for name in effects()]
    tasks += [(name, (), rng.randrange(2**31)) for _ in range(cases // 2) for name in (SQUARE, rng.choice(OTHERS))]
    rng.shuffle(tasks)
    return tasks


def main() -> None:
    parser = arguments(str(__doc__), 10, "with an effect, of each of the two kinds; 0 only reads")
    options = parser.parse_args()
    rows = read(options.out, "experiment", "truth", "seed", "drawn")
    for row in in_parallel(run, plan(options.cases, random.Random(options.seed)), options.jobs, options.out):
        rows.append(row)
        print(row["experiment"], *row["truth"], row.get("verdict", "not drawn"), row.get("named", ""), flush=True)
    print(f"\n{table(rows)}\n\n{mistakes(rows)}")
    if options.page:
        text = filled(TEMPLATE, table=table(rows), mistakes=mistakes(rows), programs=programs(rows))
        options.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
