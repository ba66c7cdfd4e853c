"""How often discovery is right: random plants, effects and sizes from the board, rates with their counts and bounds.

    python benchmarks/discovery.py --cases clear=8,none=20,pairs=10 --out results.jsonl     resumes where it stopped
    python benchmarks/discovery.py --table results.jsonl                                    prints the table

Seeds are fresh from the system unless ``--seed`` is given, and recorded. The truth comes from ``firmware_model``
through the wire; the engine sees logs only.
"""

from __future__ import annotations

import argparse
import json
import secrets
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

from discovery_cases import EFFECTS, make_case

SUITE = ("staircase", "multisine", "multisine", "multisine", "pulses", "sine_slow", "square_170_190")
DECLARED = "linear+coulomb_friction"
# Effects that are the same thing to an encoder and a duty, whatever the experiment.
CLASSES = (
    {"asymmetric_coulomb_friction", "constant_load"},
    {"gravity_load", "cogging_torque"},
    {"input_deadband", "pwm_dead_time"},
)


def same(a: str, b: str) -> bool:
    return a == b or any({a, b} <= c for c in CLASSES)


def run_case(seed: int, names: tuple[str, ...], leave_out: str | None) -> dict[str, Any]:
    """One case from board to verdict."""
    from fiohost.bench.experiment import Experiment
    from fiohost.bench.loop import Bench
    from fiohost.circle.confirm import confirm
    from fiohost.circle.evidence import diagnose
    from fiohost.circle.plan import fresh
    from fiohost.identify.intervals import estimates
    from fiohost.identify.record import record_from_log
    from fiohost.motor.effect import effects
    from fiohost.transport.profile import TargetProfile
    from fiohost.transport.simulated import SimulatedTransport
    from firmware_model import Board

    case = make_case(seed, names)
    board = Board(case.plant, seed=seed)
    with Bench(SimulatedTransport(board.step, "sim:sealed", "simulated"), TargetProfile.load()) as bench:
        logs = [bench.run(Experiment.load(name)) for name in SUITE]
        newest = bench.run(fresh(seed))
    library = [n for n in effects() if n != leave_out and not (leave_out and same(n, leave_out))]
    began = time.monotonic()
    found = diagnose(logs, (), DECLARED, library=library if leave_out else None)
    checked = confirm(record_from_log(newest), found.declared, found.final)
    declared = [j.errors.window_rms for j in found.declared.judgements]
    floor = [f.errors.window_rms for f in found.final.floors]
    known = estimates(found.final.fit, found.final.replica_models)
    return {
        "seed": seed,
        "truth": list(names),
        "left_out": leave_out,
        "reduced": case.reduced,
        "clarity": max(d / f for d, f in zip(declared, floor, strict=True) if f > 0),
        "verdict": found.verdict,
        "named": [s.effect for s in found.steps],
        "rivals": [list(s.indistinguishable_from) for s in found.steps],
        "model": dict(found.final.fit.model.values),
        "intervals": {k: e.ci95 for k, e in known.items()},
        "horizon_s": found.horizon_s,
        "confirm": {
            "before": checked.before.errors.window_rms,
            "after": checked.after.errors.window_rms,
            "floor": checked.floor.errors.window_rms,
        },
        "seconds": time.monotonic() - began,
    }


def plan(text: str, rng: Any) -> list[tuple[int, tuple[str, ...], str | None]]:
    """Cases to run: ``all=N`` (every effect N times), ``none=N``, ``pairs=N``, ``outside=N``, or ``EFFECT=N``."""
    cases: list[tuple[int, tuple[str, ...], str | None]] = []
    for item in text.split(","):
        name, _, count = item.partition("=")
        for _ in range(int(count)):
            if name == "none":
                cases.append((rng(), (), None))
            elif name == "pairs":
                names = sorted(EFFECTS)
                first = names[rng() % len(names)]
                second = names[rng() % len(names)]
                if not same(first, second):
                    cases.append((rng(), (first, second), None))
            elif name == "outside":
                names = sorted(EFFECTS)
                only = names[rng() % len(names)]
                cases.append((rng(), (only,), only))
            elif name == "all":
                cases.extend((rng(), (n,), None) for n in EFFECTS)
            else:
                cases.append((rng(), (name,), None))
    return cases


def wilson(hits: int, total: int) -> str:
    """A rate with its counts and 95 % bounds (Wilson 1927)."""
    if total == 0:
        return "-"
    z = 1.96
    p = hits / total
    middle = (p + z * z / (2 * total)) / (1 + z * z / total)
    half = z / (1 + z * z / total) * (p * (1 - p) / total + z * z / (4 * total * total)) ** 0.5
    return f"{100 * p:.0f} % ({hits}/{total}; {100 * max(middle - half, 0):.0f}..{100 * min(middle + half, 1):.0f})"


Row = dict[str, Any]


def right(row: Row) -> bool:
    """The first name is the truth, or in its class."""
    return bool(row["named"]) and any(same(row["named"][0], t) for t in row["truth"])


def in_set(row: Row) -> bool:
    """The truth is among the names and their rivals."""
    said = [n for name, rivals in zip(row["named"], row["rivals"], strict=True) for n in (name, *rivals)]
    return any(same(n, row["truth"][0]) for n in said)


def exact(row: Row) -> bool:
    """Both effects of a pair and nothing else."""
    named = row["named"]
    return len(named) == 2 and all(any(same(n, t) for n in named) for t in row["truth"])


def share(rows: list[Row], test: Callable[[Row], bool]) -> str:
    return wilson(sum(map(test, rows)), len(rows))


def table(rows: list[Row]) -> str:
    """The rates as Markdown, misses by name."""
    single = [r for r in rows if len(r["truth"]) == 1 and not r["left_out"]]
    none = [r for r in rows if not r["truth"]]
    outside = [r for r in rows if r["left_out"]]
    pairs = [r for r in rows if len(r["truth"]) == 2]
    lines = []
    for label, low, high in (("clear, 3 times the floor or more", 3.0, 1e9), ("faint, 1.2 to 3", 1.2, 3.0)):
        group = [r for r in single if low <= r["clarity"] < high]
        lines += [
            f"- {label}: first name right {share(group, right)}, in the named set {share(group, in_set)}",
            f"  explained {share(group, lambda r: r['verdict'] == 'explained')}, "
            f"more than one effect named {share(group, lambda r: len(r['named']) > 1)}",
        ]
    lines += [
        f"- effect-free: any effect claimed {share(none, lambda r: bool(r['named']))}, "
        f"called unexplained {share(none, lambda r: r['verdict'] == 'unexplained')}",
        f"- outside the library, explained away {share(outside, lambda r: r['verdict'] == 'explained')}",
        f"- pairs: exact set {share(pairs, exact)}, first pick right {share(pairs, right)}",
    ]
    ratios = sorted(r["confirm"]["after"] / r["confirm"]["floor"] for r in single if right(r) and r["clarity"] >= 3.0)
    if ratios:
        middle = ratios[len(ratios) // 2]
        lines.append(f"- fresh record, windowed error over floor: median {middle:.3f}, worst {ratios[-1]:.2f}")
    lines.append(f"- seconds a diagnosis: median {sorted(r['seconds'] for r in rows)[len(rows) // 2]:.1f}")
    return "\n".join([*lines, "", *map(story, filter(missed, rows))])


def missed(row: Row) -> bool:
    if row["left_out"]:
        return row["verdict"] == "explained"
    if not row["truth"]:
        return row["verdict"] != "no_missing_effect"
    return row["clarity"] >= 1.2 and (not right(row) or row["verdict"] != "explained")


def story(row: Row) -> str:
    """One miss in a line."""
    truth, named = ("+".join(row[key]) or "nothing" for key in ("truth", "named"))
    fresh = row["confirm"]
    return (
        f"  - {truth}, seed {row['seed']}, {row['clarity']:.1f} times the floor: {row['verdict']}, {named}; "
        f"fresh record {fresh['before']:.3f} to {fresh['after']:.3f} deg, floor {fresh['floor']:.3f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", default="all=1,none=10")
    parser.add_argument("--out", type=Path, default=Path("discovery.jsonl"))
    parser.add_argument("--seed", type=int)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--table", type=Path)
    options = parser.parse_args()
    if options.table:
        print(table([json.loads(line) for line in options.table.read_text().splitlines()]))
        return
    if options.seed is None:
        draw = lambda: secrets.randbelow(2**31)  # noqa: E731
    else:
        import random

        fixed = random.Random(options.seed)
        draw = lambda: fixed.randrange(2**31)  # noqa: E731
    cases = plan(options.cases, draw)
    with ProcessPoolExecutor(options.jobs) as pool, options.out.open("a") as out:
        waiting = {pool.submit(run_case, *case): case for case in cases}
        for i, done in enumerate(as_completed(waiting)):
            seed, names, _ = waiting[done]
            try:
                row = done.result()
            except Exception as exc:
                print(f"{names} seed {seed}: {type(exc).__name__}: {exc}", file=sys.stderr)
                continue
            out.write(json.dumps(row, default=str) + "\n")
            out.flush()
            print(
                f"{i + 1}/{len(cases)} {'+'.join(names) or 'nothing'}: {row['verdict']} {row['named']} "
                f"(x{row['clarity']:.1f}, {row['seconds']:.0f} s)",
                file=sys.stderr,
                flush=True,
            )
    print(table([json.loads(line) for line in options.out.read_text().splitlines()]))


if __name__ == "__main__":
    main()
