"""How long the keyboard waits: ``fiohost --help`` against ``python -c 'import click'``, and ``import fiohost``.

    python benchmarks/startup.py [--repeats 15]

Each is run in turn, so that all meet the same machine; ratios are of medians. ``import fiohost`` is the time that it
adds to an empty interpreter. Beside the clock stands the processor's time, which other work hardly touches.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

RUNS = {
    "nothing": ["-c", "pass"],
    "import click": ["-c", "import click"],
    "import fiohost": ["-c", "import fiohost"],
    "fiohost --help": ["-m", "fiohost", "--help"],
}


def processor_s() -> float:
    """Of all children that have ended."""
    used = os.times()
    return used.children_user + used.children_system


def seconds(arguments: list[str]) -> tuple[float, float]:
    """On the clock, and of the processor (in steps of 10 ms where the system counts so)."""
    began, began_cpu = time.perf_counter(), processor_s()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - began, processor_s() - began_cpu


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in RUNS}
    for _ in range(given.repeats + 1):
        for name, arguments in RUNS.items():
            taken[name].append(seconds(arguments))
    # the first fills caches; the processor's time is counted in coarse steps, so its mean says more than its median
    clock = {name: statistics.median(t for t, _ in values[1:]) for name, values in taken.items()}
    cpu = {name: statistics.fmean(t for _, t in values[1:]) for name, values in taken.items()}
    for name in RUNS:
        print(f"{name:16} {1e3 * clock[name]:7.1f} ms  {1e3 * cpu[name]:7.1f} ms of the processor")
    told = {}
    for kind, median in (("clock", clock), ("processor", cpu)):
        ratio = median["fiohost --help"] / median["import click"]
        added = 1e3 * (median["import fiohost"] - median["nothing"])
        print(f"{kind}: fiohost --help {ratio:.2f} times import click (at most 2); import fiohost adds {added:.1f} ms "
              "(below 50)")  # fmt: skip
        told[kind] = {"help_ratio": ratio, "import_ms": added, "seconds": median}
    if given.json:
        given.json.write_text(json.dumps(told) + "\n")


if __name__ == "__main__":
    main()
