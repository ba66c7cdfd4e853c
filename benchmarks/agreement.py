"""Board and fit side by side: every effect of the library alone, and every pair, drawn sizes, motors and commands.

    python benchmarks/agreement.py [--seeds N] [--jobs N] [--rows FILE] [--page]

Each pair runs for 20 s on as many drawn motors as there are seeds. Rows are kept, one a pair, and a run that is broken
off goes on where it was; ``--page`` writes docs/agreement.md from them.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
sys.path.insert(0, str(ROOT / "tests"))

from pairs import NAMES, PAIRS, RULE, draw_run  # noqa: E402

ROWS = ROOT / "benchmarks" / "results" / "agreement.jsonl"
PAGE = ROOT / "docs" / "agreement.md"
SPAN_S = 20.0

HEAD = """\
# Board and fit

Two simulations share no code: the board's motor (`firmware_model`, amperes and newton metres, adaptive steps, SI) and
the fit's (`fiohost/motor`, percent and degrees, exact linear flows between events). Here each effect and each pair of
effects runs on both; motors, sizes and commands (held levels, ramps, sines, brakes and run-downs) are drawn at random.
{rule}

Where the current is limited or a voltage is lost in the bridge, and the winding has a lag, the board resolves the edges
of its PWM, as the mean of a period is not all then.

Written by `python benchmarks/agreement.py --page`, {commit}; {runs} runs of {span:g} s, seeds 0 to {last}.

| | runs | agree | chaotic |
|---|---|---|---|
{summary}

Of the runs that are not chaotic, half differ by less than {median:.2g} deg over {span:g} s and 95 of 100 by less than
{most:.2g} deg.

| effects | first second, deg | whole run, deg | turned, deg | |
|---|---|---|---|---|
"""


def job(task: tuple[tuple[str, ...], int]) -> dict[str, Any]:
    names, seeds = task
    found = [draw_run(names, seed, SPAN_S) for seed in range(seeds)]
    return {
        "effects": list(names),
        "runs": [
            {
                "first_deg": f.first_deg, "whole_deg": f.whole_deg, "turned_deg": f.turned_deg,
                "chaotic": f.is_chaotic, "agrees": f.agrees,
            }
            for f in found
        ],
    }  # fmt: skip


def page(rows: list[dict[str, Any]]) -> str:
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()
    kinds = {"one effect": 1, "two effects": 2}
    lines = []
    for name, count in kinds.items():
        runs = [r for row in rows if len(row["effects"]) == count for r in row["runs"]]
        lines.append(f"| {name} | {len(runs)} | {sum(r['agrees'] for r in runs)} | {sum(r['chaotic'] for r in runs)} |")
    calm = sorted(r["whole_deg"] for row in rows for r in row["runs"] if not r["chaotic"])
    text = HEAD.format(
        rule=textwrap.fill(RULE, 120), commit=f"commit {commit}", span=SPAN_S,
        runs=sum(len(row["runs"]) for row in rows),
        last=max(len(row["runs"]) for row in rows) - 1, summary="\n".join(lines), median=calm[len(calm) // 2],
        most=calm[int(0.95 * len(calm))],
    )  # fmt: skip
    for row in sorted(rows, key=lambda row: (len(row["effects"]), row["effects"])):
        runs = row["runs"]
        calm_deg = [r["whole_deg"] for r in runs if not r["chaotic"]]
        remarks = [] if all(r["agrees"] for r in runs) else [f"**{sum(not r['agrees'] for r in runs)} do not agree**"]
        if any(r["chaotic"] for r in runs):
            remarks.append(f"{sum(r['chaotic'] for r in runs)} chaotic")
        whole = f"{max(calm_deg):.2g}" if calm_deg else "–"
        text += (
            f"| {' + '.join(row['effects'])} | {max(r['first_deg'] for r in runs):.2g} | {whole} | "
            f"{max(r['turned_deg'] for r in runs):.0f} | {', '.join(remarks)} |\n"
        )
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4, help="drawn motors a pair (4)")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--rows", type=Path, default=ROWS)
    parser.add_argument("--page", action="store_true", help="write docs/agreement.md from the rows")
    options = parser.parse_args()
    known: dict[tuple[str, ...], dict[str, Any]] = {}
    if options.rows.is_file():
        for line in options.rows.read_text(encoding="utf-8").splitlines():
            row = json.loads(line)
            known[tuple(row["effects"])] = row
    wanted = [*((name,) for name in NAMES), *PAIRS]
    left = [(names, options.seeds) for names in wanted if len(known.get(names, {"runs": []})["runs"]) < options.seeds]
    with multiprocessing.Pool(options.jobs) as pool, options.rows.open("a", encoding="utf-8") as stream:
        for done, row in enumerate(pool.imap_unordered(job, left), 1):
            known[tuple(row["effects"])] = row
            stream.write(json.dumps(row) + "\n")
            stream.flush()
            if not all(r["agrees"] for r in row["runs"]):
                worst = max(row["runs"], key=lambda r: r["whole_deg"])
                told = f"{worst['first_deg']:.3g}, {worst['whole_deg']:.3g} deg"
                print(f"{' + '.join(row['effects'])}: {told}", flush=True)
            print(f"\r{done} of {len(left)}", end="", file=sys.stderr)
    if options.page:
        PAGE.write_text(page([known[names] for names in wanted]), encoding="utf-8")
        print(f"\n{PAGE}")


if __name__ == "__main__":
    main()
