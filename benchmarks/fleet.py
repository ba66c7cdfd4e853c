"""A line test: motors of one type, a few of a bad lot among them, each measured for seconds and compared with all.

    python benchmarks/fleet.py                              1,000 motors of 20 s each, 2 % of them of a bad lot
    python benchmarks/fleet.py --motors 200 --seed 3

Prints motors per core and minute, which of the bad lot were missed and which good ones were said to stand apart, and
how well gain, lag and friction are known from a short log alone, from one with the type behind it, and from a long one
alone; and how well they could be, as motors of a type differ. Motors are drawn, simulated by the board with a random
torque on their shafts, and logged; the fleet sees the logs.
"""

from __future__ import annotations

import argparse
import os
import random
import secrets
import sys
import tempfile
import time
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from discovery_cases import motor, stall_Nm
from worlds import bounds
from worlds_logs import Hand

MODEL = "linear+coulomb_friction"
# How motors of a type differ, sd as a share.
SPREAD = {"Kt_Nm_per_A": 0.01, "R_ohm": 0.02, "J_kgm2": 0.02, "coulomb_Nm": 0.08}
# A random torque on each shaft, in percent of full duty rms, and its correlation time.
TORQUE_PCT, TORQUE_S = 1.0, 0.5
# What is the matter with a motor of the bad lot, one of these: share of a value, from one to the other.
FAULTS = {"a tight bearing": ("coulomb_Nm", 1.6, 2.5), "a weak magnet": ("Kt_Nm_per_A", 0.80, 0.92)}
NAMES = ("linear.gain_deg_s_per_pct", "linear.tau_s", "coulomb_friction.level_pct")


@dataclass(frozen=True)
class Motor:
    """One motor of the line, and what is the matter with it."""

    name: str
    seed: int
    values: Mapping[str, Any]
    fault: str


def drawn(count: int, bad_share: float, seed: int) -> list[Motor]:
    """The motors of a line, all of one drawn type."""
    rng = random.Random(f"fleet {seed}")
    type_ = motor(rng)
    bad = set(rng.sample(range(count), round(bad_share * count)))
    motors = []
    for i in range(count):
        values = dict(type_)
        for key, sd in SPREAD.items():
            values[key] *= 1.0 + sd * rng.gauss(0.0, 1.0)
        fault = rng.choice(list(FAULTS)) if i in bad else ""
        if fault:
            key, low, high = FAULTS[fault]
            values[key] *= rng.uniform(low, high)
        values["Ke_Vs_per_rad"] *= values["Kt_Nm_per_A"] / type_["Kt_Nm_per_A"]  # the magnet makes both
        motors.append(Motor(f"m{i:05d}", rng.randrange(2**31), values, fault))
    return motors


def measured(motor_: Motor, seconds: float, folder: Path) -> dict[str, float]:
    """Run one motor for some seconds of random steps and write its log: its true parameters."""
    from fiohost.bench.experiment import Experiment
    from fiohost.bench.loop import Bench
    from fiohost.bench.signals import RandomSteps
    from fiohost.transport.profile import TargetProfile
    from fiohost.transport.simulated import SimulatedTransport
    from firmware_model import Board
    from firmware_model.plants import make_plant

    steps = RandomSteps(duration_s=seconds, low=-80.0, high=80.0, hold_min_s=0.2, hold_max_s=1.5, seed=motor_.seed)
    plant = make_plant(dict(motor_.values), motor_.name)
    board = Board(plant, seed=motor_.seed)
    rms_Nm = 0.01 * TORQUE_PCT * stall_Nm(motor_.values)
    hand = Hand(board, 0.0, rms_Nm, TORQUE_S, random.Random(motor_.seed))
    line = SimulatedTransport(hand.step, f"sim:{motor_.name}", "simulated", counts_per_rev=plant.counts_per_rev)
    home = folder / motor_.name
    home.mkdir(parents=True)
    with Bench(line, TargetProfile.load()) as running:
        running.run(Experiment("line_test", [steps]), home / "run.csv")
    reduced = plant.reduced()
    return {f"{group}.{name}": float(value) for group, own in reduced.items() for name, value in own.items()}


def logged(job: tuple[Motor, float, Path]) -> dict[str, float]:
    return measured(*job)


def fleet_of(motors: list[Motor], seconds: float, folder: Path, processes: int) -> tuple[list[Any], list[Any], float]:
    """The fleet's rows, the true parameters, and the seconds that fitting took."""
    from fiohost.fleet.benches import find_benches
    from fiohost.fleet.run import run_fleet
    from fiohost.fleet.work import Settings

    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        truths = list(pool.map(logged, [(m, seconds, folder / "logs") for m in motors], chunksize=8))
    began = time.monotonic()
    rows = run_fleet(
        find_benches(folder / "logs"), folder / "out", Settings(MODEL, diagnose=False), processes=processes
    )
    return rows, truths, time.monotonic() - began


def off(rows: list[Any], truths: list[Any], values: list[np.ndarray]) -> np.ndarray:
    """Rms errors (3) of estimates as shares of the truth, in percent."""
    true = np.array([[t[n] for n in NAMES] for t in truths])
    own = np.array([v[[list(r["names"]).index(n) for n in NAMES]] for r, v in zip(rows, values, strict=True)])
    return 100.0 * np.sqrt(np.mean((own / true - 1.0) ** 2, axis=0))


def bound(rows: list[Any], truths: list[Any]) -> np.ndarray:
    """Rms errors (3), in percent, of the best linear estimate from what logs say alone, where both is known: how motors
    differ, and how that errs.
    """
    true = np.array([[t[n] for n in NAMES] for t in truths])
    own = np.array([np.array(r["values"])[[list(r["names"]).index(n) for n in NAMES]] for r in rows])
    errors, differ = own / true - 1.0, np.cov((true / np.median(true, axis=0)).T)
    information = np.linalg.inv(differ) + np.linalg.inv(errors.T @ errors / len(errors))
    return 100.0 * np.sqrt(np.diag(np.linalg.inv(information)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motors", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=20.0, help="of log for each motor")
    parser.add_argument("--bad", type=float, default=0.02, help="share of the bad lot")
    parser.add_argument("--short", type=int, default=60, help="fresh good motors with a short and a long log")
    parser.add_argument("--seed", type=int, default=None)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    chosen = parser.parse_args()
    if chosen.motors < 10 or chosen.short < 1 or not 0.0 <= chosen.bad < 0.5:
        parser.error("a type is told from 10 motors or more, fewer than half of them bad, with 1 fresh one at least")
    seed = secrets.randbelow(2**31) if chosen.seed is None else chosen.seed

    from fiohost.fleet.summary import summarised
    from fiohost.fleet.together import population

    motors = drawn(chosen.motors, chosen.bad, seed)
    fresh = [m for m in drawn(chosen.motors + chosen.short, 0.0, seed)[chosen.motors :] if not m.fault]
    with tempfile.TemporaryDirectory(prefix="fiohost-") as place:
        folder = Path(place)
        rows, _, wall_s = fleet_of(motors, chosen.seconds, folder / "line", chosen.processes)
        fleet = summarised(rows)
        short, truths, _ = fleet_of(fresh, 5.0, folder / "short", chosen.processes)
        long, _, _ = fleet_of(fresh, 60.0, folder / "long", chosen.processes)
    cpu_s = sum(r["cpu_s"] for r in rows)
    apart = {name: what for name, what, _ in fleet.apart}
    bad, good = [m for m in motors if m.fault], [m for m in motors if not m.fault]
    print(f"seed {seed}: {len(motors)} motors of one type, {chosen.seconds:g} s each, {len(bad)} of a bad lot")
    print(f"fitted: {60.0 * len(rows) / cpu_s:.0f} motors per core and minute of processor time, {wall_s:.0f} s in all "
          f"on {chosen.processes} processes; {len(fleet.failed)} failed")  # fmt: skip
    for fault in FAULTS:
        lot = [m for m in bad if m.fault == fault]
        print(f"{fault}: missed {bounds(sum(m.name not in apart for m in lot), len(lot))}")
    print(f"good motors said to stand apart: {bounds(sum(m.name in apart for m in good), len(good))}")
    type_ = population(rows)
    assert type_ is not None
    own = [np.array(r["values"]) for r in short]
    middle = [type_.mean * type_.scale for _ in short]
    behind = [type_.with_prior(np.array(r["values"]), np.array(r["covariance"], dtype=float))[0] for r in short]
    print(f"rms error in % of {', '.join(n.rpartition('.')[2] for n in NAMES)}, {len(fresh)} fresh good motors:")
    for name, error in (
        ("5 s alone", off(short, truths, own)),
        ("5 s with the type behind it", off(short, truths, behind)),
        ("  at best, all of both known", bound(short, truths)),
        ("the type's mean, no log", off(short, truths, middle)),
        ("60 s alone", off(long, truths, [np.array(r["values"]) for r in long])),
    ):
        print(f"  {name:28s}" + "".join(f"{e:8.2f}" for e in error))
    return 0


if __name__ == "__main__":
    sys.exit(main())
