"""How the diagnosis does on logs of another hand: a third simulator with conventions of its own (foreign_simulator.py).

    python benchmarks/foreign.py                            one case of each kind, drawn fresh
    python benchmarks/foreign.py --kinds lugre,nothing --cases 5
    python benchmarks/foreign.py --out rows.jsonl --page docs/foreign.md

The logs say only what a stranger's would: times, duties, counts of one turn. Some equations are not the library's.
"""

from __future__ import annotations

import random
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from foreign_simulator import DRAWS, KINDS, TICK_S, parameters, simulate
from rows import Row, arguments, filled, in_parallel, programs, read

SUITE = ("staircase", "multisine", "pulses", "sine_slow", "square_170_190")
DECLARED = "linear+coulomb_friction"
TEMPLATE = Path(__file__).with_name("foreign.template.md")


def logs(kind: str, seed: int, folder: Path) -> tuple[dict[str, Any], list[Path], list[Path]]:
    """The truth, the training logs and the held-out logs of a drawn bench, each log begun where the last one ended."""
    from fiohost.bench.experiment import Experiment
    from fiohost.circle.plan import fresh

    rng = random.Random(f"foreign {kind} {seed}")
    gain, tau, friction = rng.uniform(6.0, 14.0), rng.uniform(0.04, 0.15), rng.uniform(1.0, 6.0)
    counts_per_rev, place = rng.choice((720, 1000, 1440, 2048)), rng.random()
    values = DRAWS[kind].draw(rng, gain, tau, friction)
    truth = {"gain": gain, "tau": tau, "friction": friction, "values": values, "counts_per_rev": counts_per_rev}
    quantum, angle, clock = 360.0 / counts_per_rev, rng.uniform(0.0, 360.0), 0.0
    pwm_hz = rng.choice((2000, 5000, 20000))
    truth |= {"pwm_hz": pwm_hz}
    paths = []
    for experiment in [*(Experiment.load(name) for name in SUITE), fresh(seed)]:
        asked, coast = experiment.levels()
        kp = 1.0 if experiment.closed_loop else 0.0
        counts, duties, angle = simulate(
            KINDS.index(kind), parameters(values), gain, tau, friction, asked, coast, kp, 0.7 * friction, quantum,
            place, angle % 360.0, clock, 1.0 / pwm_hz,
        )  # fmt: skip
        clock += len(counts) * TICK_S
        paths.append(folder / f"{experiment.name}.csv")
        lines = ["# schema: fiohost.log/1", f"# sample_time_s: {TICK_S}", "# command_delay_ticks: 1",
                 f"# counts_per_rev: {counts_per_rev}", f"# pwm_hz: {pwm_hz}", "time_s,duty_pct,c3,c4,pos"]  # fmt: skip
        for k, (count, duty, free) in enumerate(zip(counts, duties, coast, strict=True)):
            c3, c4 = (0, 0) if free else (1, 1) if duty == 0.0 else (1, 0) if duty > 0.0 else (0, 1)
            lines.append(f"{k * TICK_S:.3f},{duty:g},{c3},{c4},{count % counts_per_rev}")
        paths[-1].write_text("\n".join(lines) + "\n")
    return truth, paths[:-1], paths[-1:]


def run(task: tuple[str, int]) -> Row:
    from fiohost.circle.evidence import diagnose
    from fiohost.judging.metrics import pool

    kind, seed = task
    with tempfile.TemporaryDirectory() as folder:
        truth, train, held = logs(kind, seed, Path(folder))
        cpu = time.process_time()
        found = diagnose(train, held, DECLARED)
        cpu = time.process_time() - cpu
    before, after, floor = (
        pool([x.errors for x in part]) for part in (found.before_holdout, found.after_holdout, found.floor_holdout)
    )
    if before is None or after is None or floor is None:
        raise RuntimeError("no held-out log was judged")
    return {
        "kind": kind,
        "seed": seed,
        "truth": truth,
        "verdict": found.verdict,
        "named": [[s.effect, *s.indistinguishable_from] for s in found.steps],
        "model": dict(found.final.fit.model.values),
        "before": before.window_rms / floor.window_rms,
        "after": after.window_rms / floor.window_rms,
        "cpu_s": cpu,
    }


def judged(row: Row) -> str:
    """In a word: how the names of a case are."""
    kind, named = DRAWS[row["kind"]], [names[0] for names in row["named"]]
    right = (*kind.right, *kind.beside)
    if not named:
        return "right" if not right else "not named"
    if not right or named[0] not in right:
        return "in the set" if any(n in right for n in row["named"][0]) else "WRONG"
    if not all(n in named for n in kind.beside) or not any(n in named for n in kind.right):
        return "right, not all"
    return "right" if all(n in right for n in named) else "right, and more"


def table(rows: Sequence[Row]) -> str:
    lines = ["| equation | named | verdict | held-out windows over the noise floor, before and after | CPU s | names |",
             "|---|---|---|---|---|---|"]  # fmt: skip
    for row in sorted(rows, key=lambda r: (KINDS.index(r["kind"]), r["seed"])):
        words = row["kind"].replace("_", " ") + ("" if DRAWS[row["kind"]].exact else " *")
        named = " + ".join(" or ".join(names) for names in row["named"]) or "nothing"
        figures = f"{row['before']:.2f}, {row['after']:.2f}"
        lines.append(f"| {words} | {named} | {row['verdict']} | {figures} | {row['cpu_s']:.0f} | {judged(row)} |")
    return "\n".join(lines)


def counted(rows: Sequence[Row]) -> str:
    """The counts in a sentence each."""
    told = [f"{len({r['kind'] for r in rows})} of {len(KINDS)} equations so far."]
    for exact, words in ((True, "Equations that the library has"), (False, "Equations that it has not (*)")):
        own = [r for r in rows if DRAWS[r["kind"]].exact is exact and DRAWS[r["kind"]].right]
        good = sum(judged(r) in ("right", "right, not all", "right, and more", "in the set") for r in own)
        explained = sum(r["verdict"] == "explained" for r in own)
        wrong = sum(judged(r) == "WRONG" for r in own)
        told.append(f"{words}: {good} of {len(own)} named rightly, {wrong} wrongly, {explained} explained.")
    none = [r for r in rows if not DRAWS[r["kind"]].right]
    claimed = sum(bool(r["named"]) for r in none)
    quiet = sum(r["verdict"] == "no_missing_effect" for r in none)
    told.append(f"Nothing missing: {claimed} claims in {len(none)}, {quiet} called so.")
    return " ".join(told)


def main() -> None:
    parser = arguments(str(__doc__), 1, "of each kind")
    parser.add_argument("--kinds", default=",".join(KINDS), help="a comma between each")
    options = parser.parse_args()
    unknown = sorted(set(options.kinds.split(",")) - set(KINDS) - {""})
    if unknown:
        sys.exit(f"no such kind: {', '.join(unknown)}; there are {', '.join(KINDS)}")
    rows = read(options.out, "kind", "seed", "verdict", "named", "before", "after", "cpu_s")
    rng = random.Random(options.seed)
    tasks = [(k, rng.randrange(2**31)) for k in options.kinds.split(",") if k for _ in range(options.cases)]
    for row in in_parallel(run, tasks, options.jobs, options.out):
        rows.append(row)
        print(table([row]).splitlines()[-1], flush=True)
    text = f"{counted(rows)}\n\n{table(rows)}"
    print(f"\n{text}")
    if options.page:
        options.page.write_text(filled(TEMPLATE, table=text, programs=programs(rows)), encoding="utf-8")


if __name__ == "__main__":
    main()
