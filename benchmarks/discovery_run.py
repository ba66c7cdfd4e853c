"""One case of the discovery benchmark: a drawn plant on the simulated board, its logs, and what the engine says."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass, replace
from typing import Any

from discovery_cases import make_case

SUITE = ("staircase", "multisine", "pulses", "sine_slow", "square_170_190")
# What the smoke run makes do with: 37.6 s.
STEP_S, TONES_S, PULSES_S, FRESH_S = 0.7, 10.0, 7.5, 10.0
DECLARED = "linear+coulomb_friction"
CLEAR, FAINT = 3.0, 1.2
TRIES, SHORT_TRIES = 16, 10
CLARITY_REPLICAS = 6
# Under P control play may shake the shaft within what the bench's guard takes for a stall; here logs are to be made.
PATIENCE = {"stall_s": 60.0}

Row = dict[str, Any]

# Effects that are the same thing to an encoder and a duty, whatever the experiment.
CLASSES = (
    {"asymmetric_coulomb_friction", "constant_load"},
    {"gravity_load", "cogging_torque"},
    {"input_deadband", "pwm_dead_time"},
)
# What holds another as a special case: taken out of the library with it.
HOLDS = {
    "input_deadband": "asymmetric_deadband",
    "pwm_dead_time": "asymmetric_deadband",
    "supply_drift": "gain_warm_up",
    "encoder_eccentricity": "shaft_angle_error",
    "gravity_load": "load_over_position",
    "cogging_torque": "load_over_position",
    "position_dependent_friction": "friction_over_position",
}


def same(a: str, b: str) -> bool:
    """Whether two names are one effect, or exact equivalents."""
    return a == b or any({a, b} <= c for c in CLASSES)


@dataclass(frozen=True)
class Task:
    """What to draw: clear, faint, none, pair or outside; ``seed`` begins the draws, the runs may be ``short``."""

    kind: str
    names: tuple[str, ...]
    seed: int
    short: bool = False

    @property
    def key(self) -> str:
        return f"{self.kind} {'+'.join(self.names)} {self.seed}"

    @classmethod
    def of(cls, row: Row) -> Task:
        """The task that made a row."""
        return cls(row["kind"], tuple(row["truth"]), int(row["key"].split()[-1]))


def fitted(short: bool) -> list[Any]:
    """The experiments that are fitted; the short ones are the first three, each level and pulse once."""
    from fiohost.bench.experiment import Experiment
    from fiohost.bench.signals import Staircase

    if not short:
        return [Experiment.load(name) for name in SUITE]
    stairs, tones, pulses = (Experiment.load(name) for name in SUITE[:3])
    levels = next(s for s in stairs.command if isinstance(s, Staircase))
    stairs = replace(stairs, command=(replace(levels, step_s=STEP_S, duration_s=STEP_S * len(levels.levels)),))
    return [stairs, lasting(tones, TONES_S), lasting(pulses, PULSES_S)]


def lasting(experiment: Any, seconds: float) -> Any:
    """The beginning of each of an experiment's signals."""
    return replace(experiment, command=tuple(replace(s, duration_s=seconds) for s in experiment.command))


def held_out(seed: int, short: bool) -> list[Any]:
    """Experiments of other kinds than those fitted: fresh random steps, and a square wave elsewhere."""
    from fiohost.bench.experiment import Experiment
    from fiohost.circle.plan import fresh

    if short:
        return [lasting(fresh(seed), FRESH_S)]
    square = Experiment.load("square_170_190")
    rng = random.Random(f"held out {seed}")
    middle, swing = rng.uniform(60.0, 300.0), rng.uniform(15.0, 60.0)
    wave = tuple(replace(s, low=middle - swing, high=middle + swing) for s in square.reference)  # type: ignore[type-var]
    return [fresh(seed), replace(square, name="square_elsewhere", reference=wave)]


def _bench(seed: int, names: tuple[str, ...], short: bool) -> tuple[Any, list[Any], list[Any]]:
    """The case, its training logs and its held-out logs."""
    from fiohost.bench.loop import Bench
    from fiohost.transport.profile import TargetProfile
    from fiohost.transport.simulated import SimulatedTransport
    from firmware_model import Board

    case = make_case(seed, names)
    board = Board(case.plant, seed=seed)
    profile = TargetProfile.load()
    profile = replace(profile, guards=profile.guards.changed(PATIENCE))
    with Bench(SimulatedTransport(board.step, "sim:sealed", "simulated"), profile) as bench:
        logs = [bench.run(e) for e in fitted(short)]
        return case, logs, [bench.run(e) for e in held_out(seed, short)]


def clarity(logs: list[Any]) -> float:
    """How many times its floor the declared model's window error is, in the worst log."""
    import numpy as np

    from fiohost.estimation.fit import fit_from_scratch
    from fiohost.estimation.record import record_from_log
    from fiohost.judging.floor import replica_floor
    from fiohost.judging.metrics import judge
    from fiohost.motor.model import Model

    rng = np.random.default_rng(0)
    records = [record_from_log(log) for log in logs]
    model = fit_from_scratch(Model.parse(DECLARED), records).model
    sizes = []
    for record in records:
        judgement = judge(record, model)
        floor = replica_floor(record, model, judgement, [model] * CLARITY_REPLICAS, rng).errors.window_rms
        sizes.append(judgement.errors.window_rms / floor if floor > 0 else 0.0)
    return max(sizes)


def wanted(kind: str, size: float) -> bool:
    """Whether a drawn size is of the kind asked for."""
    if kind in ("clear", "outside"):
        return size >= CLEAR
    return FAINT <= size < CLEAR if kind == "faint" else True


def run_task(task: Task) -> Row:
    """Draw until the size is that of the task, then diagnose. A row with ``drawn`` false where no draw was."""
    from fiohost.circle.evidence import diagnose
    from fiohost.discover.diagnose import parameters
    from fiohost.judging.metrics import pool
    from fiohost.motor.effect import effects

    for attempt in range(SHORT_TRIES if task.short else TRIES):
        seed = task.seed + attempt
        case, logs, held = _bench(seed, task.names, task.short)
        size = clarity(logs) if task.names else 0.0
        if wanted(task.kind, size):
            break
    else:
        return {"key": task.key, "kind": task.kind, "truth": list(task.names), "drawn": False}
    library = None
    if task.kind == "outside":
        library = [n for n in effects() if not same(n, task.names[0]) and n != HOLDS.get(task.names[0])]
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
    known = parameters(found, found.final)
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
        "seconds": seconds,
        "cpu_s": cpu,
    }
