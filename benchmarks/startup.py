"""How long the keyboard waits: ``fiohost --help`` against ``python -c 'import click'``, and ``import fiohost``.

    python benchmarks/startup.py [--repeats 15]
    python benchmarks/startup.py --keep     only uses all kernels once, so that who comes next finds them compiled

Each is run in turn, so that all meet the same machine; ratios are of medians. ``import fiohost`` is the time that it
adds to an empty interpreter. Beside the clock stands the processor's time, which other work hardly touches.

Then what the first use of all kernels costs, with nothing compiled before, and once more with what was kept; the
difference is the compilation. The host's: a stretch of normal running is learned from as ``fiohost watch`` does it. The
simulated board's, which nobody with a real board needs: one step of it.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

RUNS = {
    "nothing": ["-c", "pass"],
    "import click": ["-c", "import click"],
    "import fiohost": ["-c", "import fiohost"],
    "fiohost --help": ["-m", "fiohost", "--help"],
}
# All kernels at work: fits of whole runs and of windows, noise and its replicas, every effect of the library.
LEARNS = """
import numpy as np
from fiohost.estimation.record import make_record
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, free_run
from fiohost.watch.learn import learn
rng = np.random.default_rng(1)
at = np.arange(2400) * 0.005
duty = np.repeat(rng.uniform(-80.0, 80.0, 24), 100)
model = Model(("coulomb_friction",), {"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.08,
                                      "coulomb_friction.level_pct": 3.0})
runs = Excitation(at, at + 0.005, np.concatenate(([0.0], duty)), np.ones(2401, dtype=np.int64))
y = np.floor((free_run(model, runs, 0.2) + 0.1 * rng.standard_normal(2400)) / 0.5) * 0.5
learn(make_record("normal", at, duty, y, quantum=0.5, sample_time_s=0.005, command_delay_s=0.005, at_rest=True), model)
"""
STEPS = "from firmware_model import Board, load_plant; Board(load_plant('default')).step(bytes(64))"
KERNELS = {"the host": LEARNS, "the simulated board": STEPS}
COMPILED_S = 20.0


def compiling(code: str) -> tuple[float, float]:
    """Seconds of the processor that the first use of all kernels takes, and the second."""
    with tempfile.TemporaryDirectory() as cache:
        spans = []
        for _ in range(2):
            began = processor_s()
            subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "XDG_CACHE_HOME": cache})
            spans.append(processor_s() - began)
    return spans[0], spans[1]


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
    parser.add_argument("--keep", action="store_true", help="only use all kernels once, so that they are kept")
    given = parser.parse_args()
    if given.keep:
        used = [subprocess.Popen([sys.executable, "-P", "-c", code]) for code in KERNELS.values()]
        sys.exit(max(one.wait() for one in used))
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in RUNS}
    for _ in range(given.repeats + 1):
        for name, arguments in RUNS.items():
            taken[name].append(seconds(arguments))
    # the first fills caches; the processor's time is counted in coarse steps, so its mean says more than its median
    clock = {name: statistics.median(t for t, _ in values[1:]) for name, values in taken.items()}
    cpu = {name: statistics.fmean(t for _, t in values[1:]) for name, values in taken.items()}
    for name in RUNS:
        print(f"{name:16} {1e3 * clock[name]:7.1f} ms  {1e3 * cpu[name]:7.1f} ms of the processor")
    told: dict[str, object] = {}
    for kind, median in (("clock", clock), ("processor", cpu)):
        ratio = median["fiohost --help"] / median["import click"]
        added = 1e3 * (median["import fiohost"] - median["nothing"])
        print(f"{kind}: fiohost --help {ratio:.2f} times import click (at most 2); import fiohost adds {added:.1f} ms "
              "(below 50)")  # fmt: skip
        told[kind] = {"help_ratio": ratio, "import_ms": added, "seconds": median}
    compiled: dict[str, dict[str, float]] = {}
    for whose, code in KERNELS.items():
        first, again = compiling(code)
        print(f"first use of all kernels of {whose}: {first:.1f} s of the processor, the next {again:.1f} s: "
              f"{first - again:.1f} s of compilation (below {COMPILED_S:g})")  # fmt: skip
        compiled[whose] = {"first_cpu_s": first, "next_cpu_s": again}
    told["compile"] = compiled
    if given.json:
        given.json.write_text(json.dumps(told) + "\n")


if __name__ == "__main__":
    main()
