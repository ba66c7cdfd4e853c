"""The page of the simulated board, ``docs/board.md``, from the rows of ``board_accuracy.py``."""

from __future__ import annotations

import json
import math
import string
from pathlib import Path
from typing import Any

import numpy as np

from firmware_model.layout import THETA
from firmware_model.motor import Motor
from firmware_model.plants import Plant, make_plant

TEMPLATE = Path(__file__).with_name("board_accuracy.template.md")
PAGE = Path(__file__).resolve().parent.parent / "docs" / "board.md"
SIGNALS = ("staircase", "multisine", "closed loop")
EDGES = "edges"
ALLOWED_DEG = 5e-4
STEP_S = 0.005
DUTIES_PCT = (5.0, 10.0, 20.0, 40.0, 60.0, 80.0, 95.0)
# Heading of two columns, inductance in H (none: the plant's), effects.
RIPPLES: tuple[tuple[str, float | None, dict[str, dict[str, float]]], ...] = (
    ("slow decay", None, {}),
    ("fast decay, diodes 0.7 V", None, {"fast_decay": {"diode_V": 0.7}}),
    ("slow decay, bridge drop 0.4 V, 0.3 mH", 3e-4, {"bridge_voltage_drop": {"drop_V": 0.4}}),
)
Row = dict[str, Any]


def short(value: float) -> str:
    """Two digits: what is below a hundredth of the limit only by its power."""
    return f"{value:.1e}".replace("e-0", "e-").replace("e+00", "")


def verdict(rows: list[Row]) -> str:
    """The rule by which all signals of a case pass, or what is missed."""
    rules = [row["verdict"] for row in rows]
    if "miss" in rules:
        worst = max(rows, key=lambda row: row["error_deg"])
        return (
            f"**missed**: {short(worst['window_deg'])} in 1 s windows, "
            f"sensitivity {short(worst['sensitivity_deg'])}; {worst.get('why', 'unexplained')}"
        )
    notes = []
    for rule in ("1 s windows", "sensitivity"):
        for row in rows:
            if row["verdict"] == rule:
                figure = row["window_deg"] if rule == "1 s windows" else row["sensitivity_deg"]
                notes.append(f"{row['signal']}: {rule} ({short(figure)})")
    return "passes" + ("; " + ", ".join(notes) if notes else "")


def line(first: list[str], rows: list[Row]) -> str:
    """One case over its signals."""
    by = {row["signal"]: row for row in rows}
    cells = [short(by[signal]["error_deg"]) if signal in by else "not run" for signal in SIGNALS]
    own = short(max(row["reference_deg"] for row in rows))
    return f"| {' | '.join([*first, *cells, own, str(sum(row['counts_differ'] for row in rows)), verdict(rows)])} |"


def grouped(rows: list[Row], key: str) -> dict[Any, list[Row]]:
    groups: dict[Any, list[Row]] = {}
    for row in rows:
        groups.setdefault(row[key], []).append(row)
    return groups


def passed(rows: list[Row], what: str) -> str:
    """How many pass and the worst distance."""
    good = [row for row in rows if row["verdict"] != "miss"]
    plain = [row for row in rows if row["verdict"] == "whole run"]
    worst = max((row["error_deg"] for row in plain), default=math.nan)
    return (
        f"{len(good)} of {len(rows)} {what} pass, {len(plain)} over their whole length; the largest distance among "
        f"these is {short(worst)} deg, the median {short(float(np.median([row['error_deg'] for row in rows])))} deg."
    )


def speed(plant: Plant, duty_pct: float, pwm: str) -> float:
    """Mean speed in deg/s over the last half of 2 s, from the angle."""
    motor = Motor(plant, pwm=pwm)
    steps = round(2.0 / STEP_S)
    _, states = motor.run_many(np.ones(steps + 1, np.int64), np.full(steps + 1, duty_pct), STEP_S)
    return float(np.degrees(states[steps, THETA] - states[steps // 2, THETA]))


def ripple(motor: dict[str, float], inductance_H: float) -> list[str]:
    """Rows of the two modes at constant duty."""
    plants = [
        make_plant({**motor, "L_H": inductance_H if own is None else own, "effects": effects}, name)
        for name, own, effects in RIPPLES
    ]
    lines = []
    for duty in DUTIES_PCT:
        cells = [f"{duty:g} %"]
        for plant in plants:
            mean, edges = speed(plant, duty, "averaged"), speed(plant, duty, "edge_resolved")
            change = f"{edges - mean:+.2g} deg/s" if edges else "none"
            if mean:
                change = f"{100.0 * (edges - mean) / mean:+.2g} %"
                change = "below 1e-6 %" if abs(edges - mean) < 1e-8 * abs(mean) else change
            cells += [f"{mean:.3f} deg/s" if mean else "stands", change]
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def speeds(path: Path | None) -> str:
    """What ``board.py`` measured."""
    if path is None:
        return "`python benchmarks/board.py` measures it, behind the wire and for the motor alone."
    told = json.loads(path.read_text(encoding="utf-8"))
    lines = [
        f"Simulated time over processor time, best of some repeats ({told['machine']}, Python {told['python']}),",
        "measured by `benchmarks/board.py`. Behind the wire: reports, telemetry and a controller in Python as well.",
        "",
        "| | effects | times real time |",
        "|---|---|---|",
    ]
    return "\n".join(lines + [f"| {r['way']} | {r['plant']} | {r['times_real_time']:.0f} |" for r in told["rows"]])


def write(rows: list[Row], motor: dict[str, float], inductance_H: float, timing: Path | None) -> None:
    """Put the page together."""
    effects = [row for row in rows if row["kind"] == "effect" and row["signal"] != EDGES]
    pairs = [row for row in rows if row["kind"] == "pair"]
    edges = [row for row in rows if row["signal"] == EDGES]
    by_label = dict(sorted(grouped(effects, "label").items(), key=lambda item: (item[0] != "no effect", item[0])))
    chosen = {label: group[0]["seed"] for label, group in by_label.items()}
    by_seed = sorted(grouped(pairs, "seed").items(), key=lambda item: item[1][0]["label"])
    page = string.Template(TEMPLATE.read_text(encoding="utf-8")).substitute(
        seconds=f"{max(row['seconds'] for row in effects):g}",
        samples=round(3 * max(row["seconds"] for row in effects) / STEP_S),
        summary=passed(effects, "records"),
        effects="\n".join(line([label], group) for label, group in by_label.items()),
        pairs_summary=passed(pairs, f"records of {len(by_seed)} drawn pairs"),
        pairs="\n".join(line([group[0]["label"], str(seed)], group) for seed, group in by_seed),
        edges_s=f"{max(row['seconds'] for row in edges):g}",
        edges_summary=passed(edges, "records"),
        edges="\n".join(
            f"| {row['label']} | {short(row['error_deg'])} | {short(row['reference_deg'])} | {row['counts_differ']} |"
            for row in sorted(edges, key=lambda row: (row["label"] != "no effect", row["label"]))
        ),
        ripple="\n".join(ripple(motor, inductance_H)),
        ripple_head=" | ".join(f"{name} | change" for name, _, _ in RIPPLES),
        speeds=speeds(timing),
        seeds=", ".join(f"{label} {seed}" for label, seed in chosen.items() if label != "no effect"),
    )
    PAGE.write_text(page, encoding="utf-8")
