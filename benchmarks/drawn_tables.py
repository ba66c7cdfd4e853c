"""How often a diagnosis of tables is right: drawn motors, steady speeds and figures of responses, with their digits.

    python benchmarks/drawn_tables.py [--tables 12] [--seed N] [--json FILE]

Each seed makes two tables: steady speeds over the duty, in whole rpm, and overshoot, rise and settling of steps at five
gains, as printed. Of five seeds two lack nothing. The truth is simulated by the library's own model, so that only the
search is asked, not whether two simulators agree.
"""

from __future__ import annotations

import argparse
import json
import secrets
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import beta

from fiohost.control.closed_loop import Loop, Plant
from fiohost.discover.tables.diagnose import diagnose_tables
from fiohost.discover.tables.responses import Response, Responses
from fiohost.discover.tables.steady import CONSTANTS, Point, SteadyReadings
from fiohost.discover.tables.table import Figure, Row, Table
from fiohost.motor.model import Model

DUTIES_PCT = (5, 10, 15, 20, 30, 40, 50, 60, 80, 100)
GAINS_PCT_PER_DEG = (0.5, 0.8, 1.2, 2.0, 3.0)
FIGURES = (Figure("overshoot_pct", "%", 0.5), Figure("rise_s", "s", 0.005), Figure("settling_5_s", "s", 0.01))
SPEED = Figure("speed", "rpm", 1.0, 0.0, 6.0)
Drawn = tuple[Table, str, str | None]


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """Even in the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def motor(names: tuple[str, ...], values: dict[str, Any], lacks: tuple[str, dict[str, Any]] | None) -> Model:
    """A model of ``names`` with their values and the effect that its declaration lacks."""
    name, sizes = lacks or ("", {})
    own = {f"{name}.{key}": value for key, value in sizes.items()}
    return Model((*names, *([name] if lacks else [])), {**values, **own})


def steady(rng: np.random.Generator, kind: int) -> Drawn:
    """Speeds at ten duties, of both signs or one; declared a linear motor."""
    values = {"linear.gain_deg_s_per_pct": between(rng, 5.0, 20.0), "linear.tau_s": 0.08}
    choices: list[tuple[str, dict[str, Any]]] = [
        ("coulomb_friction", {"level_pct": between(rng, 1.0, 6.0)}),
        ("voltage_saturation", {"limit_pct": float(rng.uniform(40.0, 80.0))}),
        ("duty_curve", {"exponent": float(rng.choice([0.85, 0.9, 1.1, 1.15]))}),
    ]
    lacks = choices[kind - 2] if kind >= 2 else None
    duties = [sign * d for sign in ((-1, 1) if rng.random() < 0.5 else (1,)) for d in DUTIES_PCT]
    points = [Point(duty_pct=float(d)) for d in duties]
    blank = SteadyReadings("curve", [SPEED], [Row(str(d), {}) for d in duties], points)
    plant, constants = Plant.of(motor((), values, lacks)), [c.value for c in CONSTANTS]
    seen = [round(blank.predict(plant, i, constants)["speed"]) for i in range(len(duties))]
    rows = [Row(f"duty {d}", {"speed": float(speed)}) for d, speed in zip(duties, seen, strict=True)]
    return SteadyReadings("curve", [SPEED], rows, points), "linear", lacks[0] if lacks else None


def responses(rng: np.random.Generator, kind: int) -> Drawn:
    """Figures of steps of 120 degrees under P at five gains; declared a motor with dry friction."""
    values = {
        "linear.gain_deg_s_per_pct": between(rng, 7.0, 14.0),
        "linear.tau_s": between(rng, 0.05, 0.12),
        "coulomb_friction.level_pct": between(rng, 1.0, 4.0),
    }
    gap = {"gap_deg": between(rng, 4.0, 8.0), "load_inertia_ratio": 0.4, "side": "encoder_before_gap"}
    choices: list[tuple[str, dict[str, Any]]] = [
        ("voltage_saturation", {"limit_pct": float(rng.uniform(30.0, 55.0))}),
        ("backlash", gap),
        ("constant_load", {"level_pct": float(rng.choice([-1, 1])) * between(rng, 3.0, 8.0)}),
    ]
    lacks = choices[kind - 2] if kind >= 2 else None
    loops = [Loop(kp, sample_time_s=0.005, delay_s=0.005) for kp in GAINS_PCT_PER_DEG]
    runs = [Response(loop, 120.0, duration_s=1.5) for loop in loops]
    blank = Responses("made", FIGURES, [Row("", {}) for _ in loops], runs)
    plant, rows = Plant.of(motor(("coulomb_friction",), values, lacks)), []
    for i, kp in enumerate(GAINS_PCT_PER_DEG):
        seen = blank.predict(plant, i, ())
        rows.append(Row(f"kp {kp:g}", {f.name: round(seen[f.name] / f.quantum) * f.quantum for f in FIGURES}))
    return Responses("made", FIGURES, rows, runs), "linear+coulomb_friction", lacks[0] if lacks else None


def one(make: Any, seed: int, kind: int) -> dict[str, Any]:
    """A drawn table, diagnosed."""
    table, declared, lacks = make(np.random.default_rng([seed, kind]), kind)
    cpu = time.process_time()
    told = diagnose_tables([table], Model.parse(declared), seed=kind).to_json()
    named = [step["effect"] for step in told["steps"]]
    with_it = [named[0], *told["steps"][0]["indistinguishable_from"]] if named else []
    return {
        "table": make.__name__, "seed": seed, "lacks": lacks, "named": named, "with": with_it,
        "verdict": told["verdict"], "error_floors": told["after"]["train"]["free_run_rms"],
        "cpu_s": time.process_time() - cpu,
    }  # fmt: skip


def rate(hits: int, total: int) -> str:
    """Counts and exact 95 % bounds (Clopper and Pearson 1934)."""
    if not total:
        return "none"
    low = float(beta.ppf(0.025, hits, total - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, total - hits)) if hits < total else 1.0
    return f"{hits} of {total} ({100 * low:.0f} to {100 * high:.0f} %)"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=int, default=12, help="of each of the two kinds (12)")
    parser.add_argument("--seed", type=int, help="fresh from the system unless given")
    parser.add_argument("--json", type=Path, help="write the rows to this file as well")
    options = parser.parse_args()
    seed = secrets.randbelow(2**31) if options.seed is None else options.seed
    rows = []
    for i in range(options.tables):
        for make in (steady, responses):
            rows.append(row := one(make, seed + i, i % 5))
            print(f"{row['table']} {row['seed']}: lacks {row['lacks'] or 'nothing'}; {row['verdict']}, "
                  f"{' + '.join(row['named']) or 'nothing'}; {row['cpu_s']:.0f} CPU s", flush=True)  # fmt: skip
    lacking = [r for r in rows if r["lacks"]]
    print(f"seed {seed}")
    print("first name right:", rate(sum(r["named"][:1] == [r["lacks"]] for r in lacking), len(lacking)))
    print("truth said with the first:", rate(sum(r["lacks"] in r["with"] for r in lacking), len(lacking)))
    print(
        "wrong first names:", rate(sum(bool(r["with"]) and r["lacks"] not in r["with"] for r in lacking), len(lacking))
    )
    print(
        "claims where nothing is missing:",
        rate(sum(bool(r["named"]) for r in rows if not r["lacks"]), len(rows) - len(lacking)),
    )
    if options.json:
        options.json.write_text(json.dumps({"seed": seed, "rows": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
