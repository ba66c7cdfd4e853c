"""What a diagnosis costs: processor time and memory by stage, on one core and two, how both grow with the log, an hour.

    python benchmarks/diagnosis.py [--spans 15,150,1500] [--hour 3600] [--cases 5] [--json FILE]

Each diagnosis is in a process of its own, in which the kernels are compiled and kept from before. ``exact`` is a bench
that repeats itself to the count, ``noisy`` one with a random torque of 1 % on the shaft; the motor has drag with speed
squared that the declared model lacks. Memory is the largest resident set, of which an empty program with its libraries
takes the first figure. The cases are drawn as those of ``discovery.py``: five experiments of 158 s in all.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import secrets
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

MODEL = "linear+coulomb_friction"
DRAG_NMS2 = 0.03  # of stall torque at 1000 deg/s
TORQUE_PCT, TORQUE_S = 1.0, 0.5
AT_MOST_S, AT_MOST_MIB = 300.0, 2048.0
LEVELS = (-80.0, 80.0)
# The stages by what is said when they begin; the rest of a message says of what.
STAGES = {
    "reading": "logs read",
    "checking": "raw data checked",
    "asking": "what a command means",
    "fitting": "declared model fitted and judged",
    "whole runs": "windows: the noise that is left",
    "few": "few logs: each effect alone, in windows and whole runs",
    "scoring": "library scored",
    "refitting": "candidates refitted, held against chance and left-out logs",
    "beginning": "begun anew with each candidate",
    "adding": "effect added, the rest judged",
    "judging": "held-out logs",
    "describing": "curves of what is left",
    "finding": "smallest effects that would have been seen",
    "looking": "next experiment",
}
Row = dict[str, Any]


def made(folder: Path, seconds: float, noisy: bool, seed: int) -> Path:
    """A log of random steps of a drawn motor."""
    import math

    from discovery_cases import motor, stall_Nm
    from worlds_logs import Hand

    from fiohost.bench.experiment import Experiment
    from fiohost.bench.loop import Bench
    from fiohost.bench.signals import RandomSteps
    from fiohost.transport.profile import TargetProfile
    from fiohost.transport.simulated import SimulatedTransport
    from firmware_model import Board
    from firmware_model.plants import make_plant

    rng = random.Random(f"diagnosis {seed}")
    values = motor(rng)
    drag = DRAG_NMS2 * stall_Nm(values) / math.radians(1000.0) ** 2
    plant = make_plant({**values, "effects": {"quadratic_drag": {"drag_Nms2": drag}}}, "drawn")
    board = Board(plant, seed=seed)
    rms_Nm = 0.01 * TORQUE_PCT * stall_Nm(values) if noisy else 0.0
    hand = Hand(board, 0.0, rms_Nm, TORQUE_S, rng)
    steps = RandomSteps(duration_s=seconds, low=LEVELS[0], high=LEVELS[1], hold_min_s=0.2, hold_max_s=1.5, seed=seed)
    path = folder / f"{'noisy' if noisy else 'exact'}-{seconds:g}.csv"
    if path.exists():  # of a length that was asked for before
        return path
    line = SimulatedTransport(hand.step, "sim:drawn", "simulated", counts_per_rev=plant.counts_per_rev)
    with Bench(line, TargetProfile.load()) as bench:
        bench.run(Experiment("steps", [steps]), path)
    return path


def memory_mib() -> float:
    """The largest resident set of this process so far."""
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024.0 if sys.platform != "darwin" else 1024.0**2)


def one(logs: list[str]) -> Row:
    """A diagnosis in this process."""
    from fiohost.circle.evidence import diagnose

    empty = memory_mib()
    began, cpu = time.monotonic(), time.process_time()
    stages: dict[str, list[float]] = {}
    at = ["reading", began, cpu]

    def say(text: str) -> None:
        key, clock, used = at
        now, now_cpu = time.monotonic(), time.process_time()
        stage = stages.setdefault(str(key), [0.0, 0.0, 0.0])
        stage[0] += now - float(clock)
        stage[1] += now_cpu - float(used)
        stage[2] = memory_mib()
        at[:] = [next((k for k in STAGES if text.startswith(k)), str(key)), now, now_cpu]

    found = diagnose(logs, [], MODEL, say=say)
    say("end")
    return {
        "verdict": found.verdict,
        "named": [s.effect for s in found.steps],
        "s": time.monotonic() - began,
        "cpu_s": time.process_time() - cpu,
        "mib": memory_mib(),
        "empty_mib": empty,
        "stages": stages,
    }


def run(logs: list[Path], cores: int = 0) -> Row:
    """A diagnosis in a process of its own, on so many cores (0: all)."""
    command = [sys.executable, str(HERE / "diagnosis.py"), "--one", *map(str, logs), "--cores", str(cores)]
    told = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(told.stdout.splitlines()[-1]))


def told(row: Row) -> str:
    named = "+".join(row["named"]) or "nothing"
    return f"{row['cpu_s']:8.1f}{row['s']:9.1f}{row['mib']:8.0f}  {row['verdict']}: {named}"


def by_stage(folder: Path, seed: int) -> list[Row]:
    """Two kinds of bench, 158 s, one core and two."""
    rows = []
    for noisy in (False, True):
        log = made(folder, 158.0, noisy, seed)
        for cores in (1, 2):
            row = run([log], cores)
            rows.append({"noisy": noisy, "cores": cores} | row)
        first, second = rows[-2:]
        print(f"\n158 s, {'noisy' if noisy else 'exact'}: {first['verdict']}, {'+'.join(first['named']) or 'nothing'}; "
              f"libraries alone {first['empty_mib']:.0f} MiB")  # fmt: skip
        print(f"{'stage':60}{'CPU s':>8}{'one core s':>12}{'two cores s':>12}{'MiB':>6}")
        for key, (clock, cpu, mib) in first["stages"].items():
            other = second["stages"].get(key, [float("nan")] * 3)
            print(f"{STAGES[key]:60}{cpu:8.2f}{clock:12.2f}{other[0]:12.2f}{mib:6.0f}")
        print(f"{'in all':60}{first['cpu_s']:8.2f}{first['s']:12.2f}{second['s']:12.2f}{first['mib']:6.0f}", flush=True)
    return rows


def growth(folder: Path, spans: list[float], seed: int) -> list[Row]:
    rows: list[Row] = []
    print(
        f"\n{'log':16}{'CPU s':>8}{'clock s':>9}{'MiB':>8}  what it says; CPU over that of the log before, log over log"
    )
    for noisy in (False, True):
        before: tuple[float, float] | None = None
        for span in spans:
            row = {"noisy": noisy, "span_s": span} | run([made(folder, span, noisy, seed)])
            times = f"; {row['cpu_s'] / before[1]:.1f} times for {span / before[0]:.3g} times" if before else ""
            print(f"{'noisy' if noisy else 'exact':7}{span:7g} s {told(row)}{times}", flush=True)
            before = (span, row["cpu_s"])
            rows.append(row)
    return rows


def hour(folder: Path, span: float, seed: int) -> list[Row]:
    rows = []
    print(f"\n{span:g} s at 200 Hz (at most {AT_MOST_S:g} s and {AT_MOST_MIB:g} MiB)")
    for noisy in (False, True):
        row = {"noisy": noisy, "span_s": span} | run([made(folder, span, noisy, seed)])
        print(f"{'noisy' if noisy else 'exact':7}{span:7g} s {told(row)}", flush=True)
        rows.append(row)
    return rows


def medians(cases: int, seed: int) -> dict[str, list[float]]:
    """CPU seconds of drawn cases with nothing, one effect and two; a plant that the board refuses is drawn anew."""
    from discovery_cases import EFFECTS
    from discovery_run import Task, run_task

    from firmware_model.errors import FirmwareModelError

    rng = random.Random(f"medians {seed}")
    found: dict[str, list[float]] = {}
    for kind, count in (("none", 0), ("clear", 1), ("pair", 2)):
        while len(found.setdefault(kind, [])) < cases:
            names, drawn = tuple(rng.sample(sorted(EFFECTS), count)), rng.randrange(2**31)
            try:
                row = run_task(Task(kind, names, drawn))
            except FirmwareModelError as exc:
                print(f"drawn anew: {' and '.join(names)}, {drawn}: {exc}")
                continue
            if row["drawn"]:
                found[kind].append(row["cpu_s"])
    print("\n158 s of five experiments, two held-out ones judged beside: median CPU s (largest), of", cases, "each")
    for kind, words in (("none", "nothing missing"), ("clear", "one effect"), ("pair", "two")):
        print(f"  {words:16}{statistics.median(found[kind]):7.1f} ({max(found[kind]):.0f})", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spans", default="15,150,1500", help="lengths of log in s; empty: none")
    parser.add_argument("--hour", type=float, default=3600.0, help="the longest log in s; 0: none")
    parser.add_argument("--cases", type=int, default=5, help="drawn cases with nothing, one effect and two; 0: none")
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--one", nargs="+", help=argparse.SUPPRESS)
    parser.add_argument("--cores", type=int, default=0, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        if given.cores and hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[: given.cores])
        print(json.dumps(one(given.one)))
        return
    seed = secrets.randbelow(2**31) if given.seed is None else given.seed
    print(f"seed {seed}", flush=True)
    found: Row = {"seed": seed}
    with tempfile.TemporaryDirectory(prefix="fiohost-") as place:
        folder = Path(place)
        run([made(folder, 15.0, True, seed)])  # compiles what is not kept yet
        found["stages"] = by_stage(folder, seed)
        if given.spans:
            found["growth"] = growth(folder, [float(s) for s in given.spans.split(",")], seed)
        if given.hour:
            found["hour"] = hour(folder, given.hour, seed)
    if given.cases:
        found["medians"] = medians(given.cases, seed)
    if given.json:
        given.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
