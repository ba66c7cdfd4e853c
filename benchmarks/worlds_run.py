"""One case of the noisy worlds: a drawn plant in a world, its diagnosis, and what an oracle says can be seen at all."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from discovery_cases import Case
from discovery_run import CLEAR, DECLARED, SHORT_TRIES, TRIES, Row, clarity, fitted, held_out, same
from worlds_logs import BY_NAME, CLOCKED, run


@dataclass(frozen=True)
class WorldTask:
    """What to draw: one effect that is clear on an exact bench, or none; ``seed`` begins the draws."""

    world: str
    names: tuple[str, ...]
    seed: int
    short: bool = False

    @property
    def key(self) -> str:
        return f"{self.world}: {'+'.join(self.names) or 'none'} {self.seed}{' short' if self.short else ''}"

    @property
    def kind(self) -> str:
        return "clear" if self.names else "none"


def drawable(world: str, name: str) -> bool:
    """Whether an effect can be had in a world, and has a name beside noise: curves over the position have none."""
    from fiohost.motor.effect import effect

    return not (BY_NAME[world].restarts and name in CLOCKED) and not effect(name).points


def run_world(task: WorldTask) -> Row:
    """Draw until the effect is clear on an exact bench, lay the world over it and diagnose. A row with ``drawn`` false
    where no draw was.
    """
    from fiohost.circle.evidence import diagnose
    from fiohost.discover.result import to_json
    from fiohost.judging.metrics import pool

    world, exact = BY_NAME[task.world], BY_NAME["exact"]
    head = {"key": task.key, "world": task.world, "kind": task.kind, "truth": list(task.names)}
    for attempt in range(SHORT_TRIES if task.short else TRIES):
        seed = task.seed + attempt
        if not task.names or clarity(run(exact, seed, task.names, fitted(task.short))[1]) >= CLEAR:
            break
    else:
        return {**head, "drawn": False}
    experiments, fresh = fitted(task.short), held_out(seed, task.short)
    case, logs = run(world, seed, task.names, [*experiments, *fresh])
    train, held = logs[: len(experiments)], logs[len(experiments) :]
    began, cpu = time.monotonic(), time.process_time()
    found = diagnose(train, held, DECLARED)
    seconds, cpu = time.monotonic() - began, time.process_time() - cpu
    after, before = pool([j.errors for j in found.after_holdout]), pool([j.errors for j in found.before_holdout])
    if after is None or before is None:
        raise RuntimeError("no held-out log was judged")
    told: dict[str, Any] = to_json(found)
    return {
        **head,
        "drawn": True,
        "seed": seed,
        "reduced": case.reduced,
        "verdict": found.verdict,
        "explained_to": told.get("explained_to"),
        "named": [s.effect for s in found.steps],
        "rivals": [list(s.indistinguishable_from) for s in found.steps],
        "intervals": {k: p["ci95"] for k, p in told["final"]["parameters"].items() if p["ci95"]},
        "noise": told.get("noise"),
        "true_noise": {
            "sensor_rms": world.sensor_deg, "torque_rms_pct": world.torque_pct, "torque_time_s": world.torque_s
        },
        "held_out": {"before": before.window_rms, "after": after.window_rms},
        "seconds": seconds,
        "cpu_s": cpu,
    }  # fmt: skip


def oracle(case: Case, train: list[Any]) -> dict[str, float]:
    """By how much the true structure's deviance is below the declared model's, each with the noise that it leaves, and
    what chance reaches beside the noise of the truth.
    """
    import numpy as np

    from fiohost.discover.logs.bootstrap import draw_null
    from fiohost.discover.logs.offered import candidates, span_of
    from fiohost.discover.logs.screen import Screen
    from fiohost.discover.logs.weighed_windows import WeighedWindows
    from fiohost.estimation.fit import fit, fit_from_scratch
    from fiohost.estimation.record import record_from_log
    from fiohost.motor.model import Model

    windows = WeighedWindows([record_from_log(log) for log in train])
    without = windows.settled(fit_from_scratch(Model.parse(DECLARED), windows.records, windows=True))
    model = without.fit.model
    for name in case.truth:
        model = model.with_effect(name, case.reduced[name])
    linear = {f"linear.{k}": v for k, v in case.reduced["linear"].items()}
    friction = case.reduced.get("coulomb_friction", {})
    kept = {f"coulomb_friction.{k}": v for k, v in friction.items() if "coulomb_friction" in model.effects}
    true = windows.settled(fit(model.with_values({**linear, **kept}), windows.records, windows=True))
    null = windows.chance(without, true)
    screen = Screen(null.fit, null.records)
    offered = candidates(null.fit.model, windows.records, None, span_of(windows.records))
    scores = [screen.score(e) for e in offered]
    level = draw_null(null.fit, null.records, screen, scores, np.random.default_rng(0)).level
    return {"gain": without.deviance - true.deviance, "chance": level}


def ask_oracle(row: Row) -> Row:
    """A row with what the oracle says of its case."""
    from threadpoolctl import threadpool_limits

    short = str(row["key"]).endswith(" short")
    case, logs = run(BY_NAME[row["world"]], row["seed"], row["truth"], [*fitted(short), *held_out(row["seed"], short)])
    with threadpool_limits(limits=1, user_api="blas"):
        return {**row, "oracle": oracle(case, logs[: len(fitted(short))])}


def right(row: Row) -> bool:
    """Whether the first name is the truth, or exactly equivalent to it."""
    return bool(row["named"]) and any(same(row["named"][0], t) for t in row["truth"])


def rightly_judged(row: Row) -> bool:
    """Whether the verdict is what a bench like this allows: nothing is missing beyond what is named."""
    return str(row["verdict"]) == ("explained" if row["truth"] else "no_missing_effect")
