"""How the diagnosis does on tables as loggers of other people write them, read without a map.

    python benchmarks/loggers.py                                 two cases of each logger, drawn fresh
    python benchmarks/loggers.py --cases 4 --out rows.jsonl --page docs/loggers.md

Of each logger so many benches with a drawn effect and half as many with none; a filter of the speed is missing too
where the logger has one.
"""

from __future__ import annotations

import random
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from discovery_rates import wilson
from discovery_run import DECLARED, same
from logger_tables import DRAWS, LOGGERS, OF_ANGLES, tables
from rows import Row, arguments, filled, in_parallel, programs, read

TEMPLATE = Path(__file__).with_name("loggers.template.md")
FILTERED = "filtered speed"
Task = tuple[str, str, int]


def run(task: Task) -> Row:
    """Tables of one bench diagnosed."""
    from fiohost.circle.evidence import diagnose
    from fiohost.importing.found import Answers

    logger, kind, seed = task
    with tempfile.TemporaryDirectory() as folder:
        paths, truth = tables(logger, kind, seed, Path(folder))
        cpu = time.process_time()
        found = diagnose(paths[:-1], paths[-1:], DECLARED, table_map=Answers(**LOGGERS[logger].said))
    missing = [*([] if kind == "nothing" else [kind]), *(["speed_filter"] if logger == FILTERED else [])]
    errors = found.after_holdout[0].errors, found.floor_holdout[0].errors
    return {
        "logger": logger,
        "missing": missing,
        "seed": seed,
        "truth": truth,
        "verdict": found.verdict,
        "named": [[s.effect, *s.indistinguishable_from] for s in found.steps],
        "gain": found.final.fit.model.number("linear.gain_deg_s_per_pct") / truth["gain"] - 1.0,
        "held_out_over_floor": errors[0].window_rms / errors[1].window_rms,
        "cpu_s": time.process_time() - cpu,
    }


def first_right(row: Row) -> bool:
    return bool(row["named"]) and any(same(row["named"][0][0], name) for name in row["missing"])


def in_sets(row: Row) -> bool:
    """Whether all that is missing stands among the names."""
    told = [name for names in row["named"] for name in names]
    return all(any(same(t, name) for t in told) for name in row["missing"])


def claims(row: Row) -> bool:
    """Whether a step names nothing that is missing."""
    return any(not any(same(t, m) for t in names for m in row["missing"]) for names in row["named"])


def table(rows: Sequence[Row]) -> str:
    heads = ("logger", "first name right", "all among the names", "claimed beside", "explained, or nothing missing",
             "gain off, median", "held-out windows over the floor, median", "CPU s, median")  # fmt: skip
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]

    def line(name: str, part: Sequence[Row]) -> str:
        some = [r for r in part if r["missing"]]
        good = sum(r["verdict"] == ("explained" if r["missing"] else "no_missing_effect") for r in part)

        def middle(values: list[float], form: str) -> str:
            return format(sorted(values)[len(values) // 2], form)

        cells = [
            wilson(sum(map(first_right, some)), len(some)),
            wilson(sum(map(in_sets, some)), len(some)),
            wilson(sum(map(claims, part)), len(part)),
            wilson(good, len(part)),
            middle([100.0 * abs(r["gain"]) for r in part], ".2f") + " %",
            middle([r["held_out_over_floor"] for r in part], ".2f"),
            middle([r["cpu_s"] for r in part], ".0f"),
        ]
        return f"| {name} | {' | '.join(cells)} |"

    parts = {name: [r for r in rows if r["logger"] == name] for name in LOGGERS}
    lines += [line(name, part) for name, part in parts.items() if part]
    return "\n".join([*lines, line("all", rows)])


def mistakes(rows: Sequence[Row]) -> str:
    """The cases that are not right."""
    lines = []
    for r in rows:
        good = r["verdict"] == ("explained" if r["missing"] else "no_missing_effect")
        if not (good and in_sets(r) and not claims(r)):
            told = " + ".join(" or ".join(names) for names in r["named"]) or "nothing"
            missing = " + ".join(r["missing"]) or "nothing"
            lines.append(f"- {r['logger']}, {missing} (seed {r['seed']}): {told}, {r['verdict']}")
    return "\n".join(lines) or "- none"


def plan(cases: int, rng: random.Random) -> list[Task]:
    tasks = []
    for name, logger in LOGGERS.items():
        kinds = [k for k in DRAWS if k != "nothing" and (logger.angle or k not in OF_ANGLES)]
        drawn = [rng.choice(kinds) for _ in range(cases)] + ["nothing"] * (cases // 2)
        tasks += [(name, kind, rng.randrange(2**31)) for kind in drawn]
    rng.shuffle(tasks)
    return tasks


def main() -> None:
    parser = arguments(str(__doc__), 2, "with an effect, of each logger; 0 only reads")
    options = parser.parse_args()
    rows = read(options.out, "logger", "missing", "seed")
    for row in in_parallel(run, plan(options.cases, random.Random(options.seed)), options.jobs, options.out):
        rows.append(row)
        print(
            row["logger"],
            *row["missing"],
            row["seed"],
            row["verdict"],
            row["named"],
            f"{row['cpu_s']:.0f} s",
            flush=True,
        )
    if not rows:
        sys.exit("there are no rows")
    print(f"\n{table(rows)}\n\n{mistakes(rows)}")
    if options.page:
        text = filled(
            TEMPLATE, table=table(rows), mistakes=mistakes(rows), programs=programs(rows), cases=str(len(rows))
        )
        options.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
