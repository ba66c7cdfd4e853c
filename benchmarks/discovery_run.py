"""One case of the discovery benchmark: a drawn plant on the simulated board, its logs, and what the engine says."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass, replace
from typing import Any

from discovery_cases import make_case

SUITE = ("staircase", "multisine", "pulses", "sine_slow", "square_170_190")
DECLARED = "linear+coulomb_friction"
CLEAR, FAINT = 3.0, 1.2
TRIES = 40

Row = dict[str, Any]

# Effects that are the same thing to an encoder and a duty, whatever the experiment.
CLASSES = (
    {"asymmetric_coulomb_friction", "constant_load"},
    {"gravity_load", "cogging_torque"},
    {"input_deadband", "pwm_dead_time"},
)


def same(a: str, b: str) -> bool:
    """Whether two names are one effect, or exact equivalents."""
    return a == b or any({a, b} <= c for c in CLASSES)


@dataclass(frozen=True)
class Task:
    """What to draw: ``kind`` is clear, faint, none, pair or outside; ``seed`` begins the draws."""

    kind: str
    names: tuple[str, ...]
    seed: int

    @property
    def key(self) -> str:
        return f"{self.kind} {'+'.join(self.names)} {self.seed}"


def held_out(seed: int) -> list[Any]:
    """Experiments of other kinds than those fitted: fresh random steps, and a square wave elsewhere."""
    from fiohost.bench.experiment import Experiment
    from fiohost.circle.plan import fresh

    square = Experiment.load("square_170_190")
    rng = random.Random(f"held out {seed}")
    middle, swing = rng.uniform(60.0, 300.0), rng.uniform(15.0, 60.0)
    wave = tuple(replace(s, low=middle - swing, high=middle + swing) for s in square.reference)  # type: ignore[type-var]
    return [fresh(seed), replace(square, name="square_elsewhere", reference=wave)]


def _bench(seed: int, names: tuple[str, ...]) -> tuple[Any, list[Any], list[Any]]:
    """The case, its training logs and its held-out logs."""
    from fiohost.bench.experiment import Experiment
    from fiohost.bench.loop import Bench
    from fiohost.transport.profile import TargetProfile
    from fiohost.transport.simulated import SimulatedTransport
    from firmware_model import Board

    case = make_case(seed, names)
    board = Board(case.plant, seed=seed)
    with Bench(SimulatedTransport(board.step, "sim:sealed", "simulated"), TargetProfile.load()) as bench:
        logs = [bench.run(Experiment.load(name)) for name in SUITE]
        return case, logs, [bench.run(e) for e in held_out(seed)]


def clarity(logs: list[Any]) -> float:
    """How many times its floor the declared model's window error is, in the worst log; 0 where nothing shows."""
    import numpy as np

    from fiohost.discover.search import Search
    from fiohost.identify.fit import fit_from_scratch
    from fiohost.identify.record import record_from_log
    from fiohost.motor.model import Model

    records = [record_from_log(log) for log in logs]
    search = Search(records, None, np.random.default_rng(0), None, lambda text: None)
    stage = search.stage(fit_from_scratch(Model.parse(DECLARED), search.records))
    if stage.at_floor:
        return 0.0
    pairs = zip(stage.judgements, stage.floors, strict=True)
    return max((j.errors.window_rms / f.errors.window_rms for j, f in pairs if f.errors.window_rms > 0), default=0.0)


def wanted(kind: str, size: float) -> bool:
    """Whether a drawn size is of the kind asked for."""
    if kind in ("clear", "outside"):
        return size >= CLEAR
    return FAINT <= size < CLEAR if kind == "faint" else True


def run_task(task: Task) -> Row:
    """Draw until the size is that of the task, then diagnose. A row with ``drawn`` false where no draw was."""
    from fiohost.circle.evidence import diagnose
    from fiohost.discover.metrics import pool
    from fiohost.identify.intervals import estimates
    from fiohost.motor.effect import effects

    for attempt in range(TRIES):
        seed = task.seed + attempt
        case, logs, held = _bench(seed, task.names)
        size = clarity(logs)
        if wanted(task.kind, size):
            break
    else:
        return {"key": task.key, "kind": task.kind, "truth": list(task.names), "drawn": False}
    library = None
    if task.kind == "outside":
        library = [n for n in effects() if not same(n, task.names[0])]
    began, cpu = time.monotonic(), time.process_time()
    found = diagnose(logs, held, DECLARED, library=library)
    seconds, cpu = time.monotonic() - began, time.process_time() - cpu
    after, floor = pool([j.errors for j in found.after_holdout]), pool([f.errors for f in found.floor_holdout])
    before = pool([j.errors for j in found.before_holdout])
    if after is None or floor is None or before is None:
        raise RuntimeError("no held-out log was judged")
    tails = [
        j.errors.window_rms <= sorted(d.errors.window_rms for d in f.draws)[-1] * 1.005
        for j, f in zip(found.after_holdout, found.floor_holdout, strict=True)
    ]
    known = estimates(found.final.fit, found.final.scattered_models)
    return {
        "key": task.key,
        "kind": task.kind,
        "truth": list(task.names),
        "drawn": True,
        "seed": seed,
        "clarity": size,
        "reduced": case.reduced,
        "verdict": found.verdict,
        "named": [s.effect for s in found.steps],
        "rivals": [list(s.indistinguishable_from) for s in found.steps],
        "model": dict(found.final.fit.model.values),
        "intervals": {k: list(e.ci95) for k, e in known.items()},
        "held_out": {"before": before.window_rms, "after": after.window_rms, "floor": floor.window_rms},
        "logs_within_replicas": sum(tails),
        "logs_held_out": len(tails),
        "horizon_s": found.horizon_s,
        "seconds": seconds,
        "cpu_s": cpu,
    }
