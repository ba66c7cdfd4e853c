"""False alarms and detection delay of ``fiohost watch``, simulated.

    python benchmarks/watch.py [--hours 24] [--repeats 4] [--processes 2] [--json FILE]

Normal running: motors of random constants under random commands, the winding's and the bearings' temperature and the
load drifting as Ornstein-Uhlenbeck processes (not the random walks that the watch assumes), with sensor counts, sensor
noise and a random torque. Every run learns from its own first 30 s. Then, for each effect and size, the seconds from
its onset to the alarm, and how often the effect is the first of those named some windows later.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fiohost.estimation.record import Record, make_record
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.estimate import Noise, Ranged
from fiohost.noise.runs import varied
from fiohost.watch.evidence import piece
from fiohost.watch.learn import learn
from fiohost.watch.replicas import drifting_run
from fiohost.watch.settings import SETTINGS

TICK_S, QUANTUM_DEG, LEARN_S = 0.005, 0.5, 30.0
NORMAL_S, FAULTY_S, ONSET_S = 1230.0, 160.0, 120.0
# Correlation time in s and standard deviation of gain (share), friction (share) and load (percent of duty).
DRIFT = ((900.0, 0.03), (900.0, 0.15), (240.0, 0.5))
# Rows judged at once.
CHUNK = round(SETTINGS.chunk_windows / 2 / TICK_S)
# Duty in the commands, seconds that a level holds at least and at most.
DUTY_PCT, HOLD_S = 80.0, (0.2, 1.5)

Change = Callable[[Model], Model]


def changed(key: str, factor: float = 1.0, plus: float = 0.0) -> Change:
    return lambda m: m.with_values({key: m.number(key) * factor + plus})


def added(name: str, **values: float | str) -> Change:
    return lambda m: m.with_effect(name, values)


def loaded(level_pct: float) -> Change:
    """More load than there is, which may have drifted to none."""

    def change(model: Model) -> Model:
        if "constant_load" not in model.effects:
            model = model.with_effect("constant_load", {"level_pct": 0.0})
        return changed("constant_load.level_pct", plus=level_pct)(model)

    return change


LEVEL, GAIN, TAU = "coulomb_friction.level_pct", "linear.gain_deg_s_per_pct", "linear.tau_s"
FAULTS: list[tuple[str, str, Change]] = [
    ("parameter_change (friction)", "+1 % duty", changed(LEVEL, plus=1.0)),
    ("parameter_change (friction)", "+2 % duty", changed(LEVEL, plus=2.0)),
    ("parameter_change (friction)", "+4 % duty", changed(LEVEL, plus=4.0)),
    ("parameter_change (gain)", "-3 %", changed(GAIN, 0.97)),
    ("parameter_change (gain)", "-6 %", changed(GAIN, 0.94)),
    ("parameter_change (gain)", "-12 %", changed(GAIN, 0.88)),
    ("parameter_change (inertia)", "+10 %", changed(TAU, 1.10)),
    ("parameter_change (inertia)", "+25 %", changed(TAU, 1.25)),
    ("constant_load", "1 %", loaded(1.0)),
    ("constant_load", "2 %", loaded(2.0)),
    ("constant_load", "4 %", loaded(4.0)),
    ("gravity_load", "1 %", added("gravity_load", level_pct=1.0, phase_deg=40.0)),
    ("gravity_load", "3 %", added("gravity_load", level_pct=3.0, phase_deg=40.0)),
    ("backlash", "1 deg", added("backlash", gap_deg=1.0)),
    ("backlash", "3 deg", added("backlash", gap_deg=3.0)),
    ("input_deadband", "1 %", added("input_deadband", level_pct=1.0)),
    ("input_deadband", "3 %", added("input_deadband", level_pct=3.0)),
    ("transport_delay", "5 ms", added("transport_delay", delay_s=0.005)),
    ("transport_delay", "15 ms", added("transport_delay", delay_s=0.015)),
    ("voltage_saturation", "at 70 %", added("voltage_saturation", limit_pct=70.0)),
    ("voltage_saturation", "at 50 %", added("voltage_saturation", limit_pct=50.0)),
    ("quadratic_drag", "3 % at 1000 deg/s", added("quadratic_drag", pct_at_1000_deg_s=3.0)),
    ("quadratic_drag", "8 % at 1000 deg/s", added("quadratic_drag", pct_at_1000_deg_s=8.0)),
    ("supply_sag", "0.05", added("supply_sag", ratio=0.05)),
    ("supply_sag", "0.15", added("supply_sag", ratio=0.15)),
    ("encoder_eccentricity", "1 deg", added("encoder_eccentricity", level_deg=1.0, order=1.0, phase_deg=20.0)),
    ("encoder_eccentricity", "3 deg", added("encoder_eccentricity", level_deg=3.0, order=1.0, phase_deg=20.0)),
]


def motor(rng: np.random.Generator) -> tuple[Model, Noise]:
    """A motor and its noise at random."""
    model = Model(
        ("coulomb_friction",),
        {GAIN: rng.uniform(6.0, 14.0), TAU: rng.uniform(0.04, 0.12), LEVEL: rng.uniform(1.5, 5.0)},
    )
    torque = rng.uniform(0.1, 0.4)
    return model, Noise(Ranged(0.05, 0.0, 0.0), Ranged(torque, 0.0, 0.0), Ranged(rng.uniform(0.05, 0.5), 0.0, 0.0))


def commanded(seconds: float, rng: np.random.Generator) -> Record:
    """A record of random levels, still without its output."""
    n = round(seconds / TICK_S)
    holds = np.repeat(rng.uniform(-DUTY_PCT, DUTY_PCT, n), rng.integers(*(round(h / TICK_S) for h in HOLD_S), n))
    times = np.arange(n) * TICK_S
    return make_record("simulated", times, holds[:n], np.zeros(n), quantum=QUANTUM_DEG, sample_time_s=TICK_S,
                       command_delay_s=TICK_S, at_rest=True)  # fmt: skip


def drift(seconds: float, rng: np.random.Generator) -> np.ndarray:
    """What drifts (seconds, 3), one row a second."""
    found = np.empty((int(seconds) + 2, 3))
    found[0] = [sd * rng.standard_normal() for _, sd in DRIFT]
    for i in range(1, len(found)):
        for j, (time_s, sd) in enumerate(DRIFT):
            stays = np.exp(-1.0 / time_s)
            found[i, j] = stays * found[i - 1, j] + sd * np.sqrt(1.0 - stays**2) * rng.standard_normal()
    return found


def watched(seconds: float, seed: int, change: Change | None = None) -> dict[str, Any]:
    """One run: its alarms in s, and of the last one after the onset what was named; CPU seconds of both parts."""
    rng = np.random.default_rng(seed)
    model, noise = motor(rng)
    record = commanded(seconds, rng)
    models = [varied(model, own) for own in drift(seconds, rng)]
    if change is not None:
        models = [change(m) if i >= ONSET_S else m for i, m in enumerate(models)]
    record = replace(record, y=drifting_run(record, models, Start(0.0, 0.0), noise, rng))
    n = round(LEARN_S / TICK_S)
    ex = record.excitation
    first = make_record("first", ex.times_s[:n], ex.duties_pct[1 : n + 1], record.y[:n], quantum=QUANTUM_DEG,
                        sample_time_s=TICK_S, command_delay_s=TICK_S, at_rest=True)  # fmt: skip
    began = time.process_time()
    learned = learn(first, model, seed=seed)
    taught = time.process_time()
    detector, events = learned.detector(), []
    lead = round(SETTINGS.lead_s / TICK_S)
    for begin in range(n, len(record), CHUNK):
        part = piece(record, begin, min(begin + CHUNK, len(record)), lead)
        for window in learned.evidence(part, 0.0, detector.at):
            events += detector.push(window)
    alarms = [e.time_s for e in events if e.kind in ("alarm", "drifted")]
    named = [
        f"{e.causes[0].effect}{f' ({e.causes[0].what})' if e.causes[0].what else ''}" if e.causes else "unexplained"
        for e in events if e.kind == "named" and e.since_s > ONSET_S - 30.0
    ]  # fmt: skip
    kinds = [(e.kind, round(e.time_s), round(e.since_s), round(e.surprise, 1), e.effect) for e in events]
    kinds.append(("drift", *np.round(detector.at, 3).tolist()))
    return {"alarms": alarms, "named": named[0] if named else None, "events": kinds,
            "learn_s": taught - began, "watch_s": time.process_time() - taught}  # fmt: skip


def _normal(seed: int) -> dict[str, Any]:
    return watched(NORMAL_S, 1000 + seed)


def _faulty(job: tuple[int, int]) -> dict[str, Any]:
    which, repeat = job
    return watched(FAULTY_S, 100_000 + 100 * which + repeat, FAULTS[which][2])


def _hours(runs: int) -> float:
    return runs * (NORMAL_S - LEARN_S) / 3600.0


def _say_normal(normal: list[dict[str, Any]], runs: int) -> None:
    false = sum(len(r["alarms"]) for r in normal)
    print(f"normal running: {false} false alarms in {_hours(runs):.1f} h simulated, {runs} motors")
    for i, run in enumerate(normal):
        if run["alarms"]:
            print(f"  motor {i}: {run['events']}")
    cpu = 1e3 * sum(r["watch_s"] for r in normal) / (runs * (NORMAL_S - LEARN_S))
    learning = np.median([r["learn_s"] for r in normal])
    print(f"learning: {learning:.1f} s CPU; watching: {cpu:.2f} ms CPU a second\n", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--repeats", type=int, default=4)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    runs = int(np.ceil(given.hours * 3600.0 / (NORMAL_S - LEARN_S)))
    with ProcessPoolExecutor(given.processes) as pool:
        normal = list(pool.map(_normal, range(runs)))
        _say_normal(normal, runs)
        jobs = [(i, k) for i in range(len(FAULTS)) for k in range(given.repeats)]
        faulty = list(pool.map(_faulty, jobs))
    hours, false = _hours(runs), sum(len(r["alarms"]) for r in normal)
    print("| effect | size | detected | delay s: median | longest | named first | others named |")
    print("|---|---|---|---|---|---|---|")
    rows = []
    for i, (effect, size, _) in enumerate(FAULTS):
        own = faulty[i * given.repeats : (i + 1) * given.repeats]
        delays = [a[0] - ONSET_S for r in own if (a := [t for t in r["alarms"] if t > ONSET_S])]
        right = sum(r["named"] == effect for r in own)
        others = sorted({str(r["named"]) for r in own if r["named"] not in (None, effect)})
        middle, longest = (np.median(delays), max(delays)) if delays else (np.nan, np.nan)
        rows.append({"effect": effect, "size": size, "detected": len(delays), "of": len(own), "delays_s": delays,
                     "named_first": right, "others": others})  # fmt: skip
        print(f"| {effect} | {size} | {len(delays)} of {len(own)} | {middle:.1f} | {longest:.1f} | {right} | "
              f"{', '.join(others) or '-'} |")  # fmt: skip
    if given.json:
        result = {"hours": hours, "motors": runs, "false_alarms": false, "learn_s": LEARN_S, "effects": rows,
                  "allowed": hours / SETTINGS.false_alarm_h}  # fmt: skip
        given.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
