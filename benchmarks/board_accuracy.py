"""How far the simulated board is from an independent solution of the same machine, effect by effect and in drawn pairs.

    python benchmarks/board_accuracy.py --pairs 30 --jobs 2 --out accuracy.jsonl    resumes where it stopped
    python benchmarks/board_accuracy.py --page accuracy.jsonl                       writes docs/board.md

Sizes and pairs are drawn by seeds fresh from the system, recorded with each row. The reference is ``board_reference``
beside the tests: scipy's ``solve_ivp`` with event location, sharing no code with the board.
"""

from __future__ import annotations

import argparse
import json
import math
import secrets
import struct
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

from board_reference.compare import STEP_S, Run, distance, driven, sensitivity, solved, state_of, windows
from board_reference.draws import MOTOR, SIZES, WINDING_H, drawn, drawn_pair, plant_with

from firmware_model.bridge import drive
from firmware_model.motor import Motor
from firmware_model.plants import Plant
from firmware_model.report import parse

ALLOWED_DEG = 5e-4
CHAOS = 3.0  # times the reference's own sensitivity to 1e-9 rad
LOOSER = 10.0  # the reference's tolerance for its own error
SIGNALS = ("staircase", "multisine", "closed loop")
# Rows of the table with something of the draw held fast.
EDGES = "edges"
EDGES_S = 0.2
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "backlash, a disc of no inertia": ("backlash", {"load_inertia_kgm2": 0.0}),
    "backlash, two inertias": ("backlash", {"load_inertia_kgm2": 0.5 * MOTOR["J_kgm2"]}),
    "parameter_change, inertia": ("parameter_change", {"which": "inertia"}),
    "parameter_change, friction": ("parameter_change", {"which": "friction"}),
    "parameter_change, gain": ("parameter_change", {"which": "gain"}),
}
Row = dict[str, Any]
Commands = tuple[np.ndarray, np.ndarray]


def labels() -> list[str]:
    """Rows of the table of effects."""
    varied = {name for name, _ in VARIANTS.values()}
    return ["no effect", *sorted([*(name for name in SIZES if name not in varied), *VARIANTS])]


def single(label: str, seed: int) -> Plant:
    """The default motor with one drawn effect."""
    if label == "no effect":
        return plant_with({})
    name, fixed = VARIANTS.get(label, (label, {}))
    return plant_with({name: {**drawn(name, np.random.default_rng(seed)), **fixed}})


# -- signals


def on_the_wire(duty_pct: float) -> tuple[int, float]:
    """Mode and duty that the board makes of a signed duty: through the report's bytes and the timer."""
    command = parse(struct.pack("<fBB58x", abs(duty_pct), int(duty_pct > 0.0), int(duty_pct < 0.0)))
    assert command is not None
    return drive(command)


def staircase(rng: np.random.Generator, steps: int) -> Commands:
    """Levels to +-80 %, half a second each, a brake or a standby now and then."""
    modes, duties = np.ones(steps, np.int64), np.zeros(steps)
    for first in range(0, steps, 100):
        kind = rng.choice(3, p=(0.1, 0.8, 0.1))
        modes[first : first + 100] = kind
        if kind == 1:
            modes[first : first + 100], duties[first : first + 100] = on_the_wire(rng.uniform(-80.0, 80.0))
    return modes, duties


def short_staircase(rng: np.random.Generator, steps: int) -> Commands:
    """Levels to +-80 %, 25 ms each, a standby and a brake among them."""
    modes, duties = np.ones(steps, np.int64), np.zeros(steps)
    for first in range(0, steps, 5):
        modes[first : first + 5], duties[first : first + 5] = on_the_wire(rng.uniform(-80.0, 80.0))
    modes[15:20], modes[30:35] = 0, 2
    duties[modes != 1] = 0.0
    return modes, duties


def multisine(rng: np.random.Generator, steps: int) -> Commands:
    """Ten lines from 0.1 to 8 Hz, +-60 % in all, a new duty at every step."""
    time_s = np.arange(steps) * STEP_S
    wave = sum(np.sin(2.0 * math.pi * f * time_s + rng.uniform(0.0, 2.0 * math.pi)) for f in np.geomspace(0.1, 8.0, 10))
    commands = [on_the_wire(duty) for duty in 60.0 * wave / np.max(np.abs(wave))]
    return np.array([mode for mode, _ in commands]), np.array([duty for _, duty in commands])


def closed_loop(plant: Plant, rng: np.random.Generator, steps: int) -> Run:
    """A PD controller on the counter follows a square wave; what it sent is the record."""
    motor = Motor(plant)
    height_deg, gain, lead_s = rng.uniform(10.0, 90.0), rng.uniform(0.5, 3.0), rng.uniform(0.0, 0.05)
    modes, duties, counts = np.ones(steps, np.int64), np.zeros(steps), np.zeros(steps, np.int64)
    states = []
    before = sent = 0.0
    for k in range(steps):
        states.append(state_of(motor))
        counts[k] = motor.count
        error = height_deg * (1.0 if k % 400 < 200 else -1.0) - 360.0 * motor.count / plant.counts_per_rev
        modes[k], duties[k] = on_the_wire(sent)  # of the telemetry before
        sent = float(np.clip(gain * (error + lead_s * (error - before) / STEP_S), -100.0, 100.0))
        before = error
        motor.run(int(modes[k]), float(duties[k]), STEP_S)
    return Run(plant, modes, duties, tuple(states), counts)


# -- one case


def run_case(kind: str, label: str, seed: int, signal: str, seconds: float) -> Row:
    """Board and reference on one record."""
    began = time.monotonic()
    plant = single(label, seed) if kind == "effect" else drawn_pair(np.random.default_rng(seed))
    if signal == EDGES and "parameter_change" in plant.effects:
        change = {**plant.effects["parameter_change"], "time_s": 0.5 * seconds}
        plant = plant_with({"parameter_change": change})
    steps, rng = round(seconds / STEP_S), np.random.default_rng([seed, (*SIGNALS, EDGES).index(signal)])
    if signal == EDGES:
        run = driven(plant, *short_staircase(rng, steps), edges=True)
    elif signal == "closed loop":
        run = closed_loop(plant, rng, steps)
    else:
        run = driven(plant, *(staircase if signal == "staircase" else multisine)(rng, steps))
    angles, counts = solved(run)
    loose, _ = solved(run, looser=LOOSER)
    error = distance(run, angles)
    row: Row = {
        "kind": kind,
        "label": label if kind == "effect" else " + ".join(plant.effects),
        "seed": seed,
        "signal": signal,
        "seconds": seconds,
        "effects": {name: dict(values) for name, values in plant.effects.items()},
        "inductance_H": plant.L_H,
        "error_deg": error,
        "reference_deg": float(np.max(np.abs(angles - loose))),
        "travel_deg": float(np.sum(np.abs(np.diff(angles)))),
        "counts_differ": int(np.sum(run.counts != counts)),
        "chaotic": run.two_bodies_with_play,
        "window_deg": None,
        "sensitivity_deg": None,
    }
    if error > ALLOWED_DEG or row["chaotic"]:
        row["window_deg"] = windows(run, round(1.0 / STEP_S))
        row["sensitivity_deg"] = sensitivity(run, angles)
    row["verdict"] = verdict(row)
    row["took_s"] = time.monotonic() - began
    return row


def verdict(row: Row) -> str:
    """By which rule a row passes: the whole run; for two bodies with play also windows or sensitivity; else a miss."""
    if row["error_deg"] <= ALLOWED_DEG:
        return "whole run"
    if row["chaotic"] and row["window_deg"] <= ALLOWED_DEG:
        return "1 s windows"
    if row["chaotic"] and row["error_deg"] <= CHAOS * row["sensitivity_deg"]:
        return "sensitivity"
    return "miss"


def cases(pairs: int, rows: list[Row], seconds: float) -> Iterator[tuple[str, str, int, str, float]]:
    """All that is not in ``rows`` yet; unfinished effects and pairs keep their seed."""
    for label in labels():
        done = {row["signal"]: row["seed"] for row in rows if row["kind"] == "effect" and row["label"] == label}
        seed = next(iter(done.values()), secrets.randbelow(2**31))
        if EDGES not in done:
            yield "effect", label, seed, EDGES, EDGES_S
        yield from (("effect", label, seed, signal, seconds) for signal in SIGNALS if signal not in done)
    seeds = list(dict.fromkeys(row["seed"] for row in rows if row["kind"] == "pair"))
    seeds += [secrets.randbelow(2**31) for _ in range(pairs - len(seeds))]
    have = {(row["seed"], row["signal"]) for row in rows if row["kind"] == "pair"}
    yield from (("pair", "", s, signal, seconds) for s in seeds for signal in SIGNALS if (s, signal) not in have)


def work(options: argparse.Namespace, tell: Callable[[str], None]) -> None:
    """Run what is missing, a line of JSON each."""
    rows = read(options.out) if options.out.exists() else []
    todo = list(cases(options.pairs, rows, options.seconds))
    with ProcessPoolExecutor(options.jobs) as pool, options.out.open("a", encoding="utf-8") as out:
        waiting = {pool.submit(run_case, *case): case for case in todo}
        for i, done in enumerate(as_completed(waiting)):
            case = waiting[done]
            try:
                row = done.result()
            except Exception as exc:
                tell(f"{i + 1}/{len(todo)} {case}: {type(exc).__name__}: {exc}")
                continue
            out.write(json.dumps(row) + "\n")
            out.flush()
            tell(
                f"{i + 1}/{len(todo)} {row['label']}, {row['signal']}: {row['error_deg']:.1e} deg, "
                f"{row['verdict']} ({row['took_s']:.0f} s)"
            )


def read(path: Path) -> list[Row]:
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("accuracy.jsonl"))
    parser.add_argument("--page", type=Path, help="write the page from this file of rows")
    parser.add_argument("--speeds", type=Path, help="what board.py --json wrote, for the page")
    options = parser.parse_args()
    if options.page is None:
        work(options, lambda text: print(text, file=sys.stderr, flush=True))
        return
    from board_page import write

    write(read(options.page), MOTOR, WINDING_H, options.speeds)


if __name__ == "__main__":
    main()
