"""A LEGO NXT motor at constant powers, University of Trento: fitted on even tens of power, judged on the fives.

The folder holds ``power_005.csv`` .. ``power_100.csv`` of the public data named in ``configs/maps/nxt_open_loop.toml``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from measured_page import begun, common, pair, save, table

from fiohost.circle.evidence import diagnose
from fiohost.discover.diagnose import Diagnosis
from fiohost.discover.result import to_json
from fiohost.estimation.fit import fit, fit_from_scratch
from fiohost.estimation.record import Record, make_record
from fiohost.judging.metrics import Judgement, judge
from fiohost.motor.model import Model
from fiohost.report import words
from fiohost.report.diagnosis import series_of
from fiohost.report.plots import plot_curve, plot_residual_bars, plot_series
from fiohost.report.series import CurvePlot
from fiohost.workers import each

MAP = "nxt_open_loop"
FIT = range(10, 101, 10)
JUDGE = range(15, 96, 10)
START_S = 2.0
SHOWN = "power_045.csv"
# Below this power the counts are as large as what is looked for.
CLEAR_PCT = 20.0
# A change of the speed per percent of power from one run to the next that no friction explains.
JUMP_PCT = 1.0


@dataclass(frozen=True)
class Run:
    """One measured run beside its simulations; speeds per percent of power in deg/s, the lag in s, ripple in deg."""

    power_pct: float
    told: Mapping[str, Any]
    speed: float
    speed_before: float
    speed_after: float
    drift_pct: float
    own_lag_s: float
    own_ripple_rms: float
    own_ripple_pct: float

    @property
    def held_out(self) -> bool:
        return bool(self.told["role"] == "holdout")

    @property
    def off_pct(self) -> float:
        return 100.0 * (self.speed / self.speed_after - 1.0)


def slope(record: Record, y: np.ndarray, begin_s: float, end_s: float) -> float:
    """Mean speed of an angle (n) between two times, by a straight line."""
    times = record.excitation.times_s
    part = (times >= begin_s) & (times < end_s)
    return float(np.polyfit(times[part], y[part], 1)[0])


def own_lag(record: Record) -> float:
    """Lag in s of a linear motor fitted to the start of this run alone."""
    times = record.excitation.times_s
    n = int(np.searchsorted(times, START_S))
    duties = record.excitation.duties_pct[1 : n + 1]
    start = make_record(record.name, times[:n], duties, record.y[:n], quantum=record.quantum, at_rest=True)
    return fit_from_scratch(Model.parse("linear"), [start]).model.number("linear.tau_s")


def own_ripple(record: Record) -> tuple[float, float]:
    """A linear motor with a once-a-turn load fitted to this run alone: error in 1 s windows (deg rms), load (%)."""
    speed = slope(record, record.y, 2.0, record.seconds) / float(record.excitation.duties_pct[-1])
    guess = Model(values={"linear.gain_deg_s_per_pct": speed, "linear.tau_s": 0.06})
    begun = [{"level_pct": level, "phase_deg": float(phase)} for level in (0.15, 0.4) for phase in range(0, 360, 60)]
    trials = [guess.with_effect("gravity_load", values) for values in begun]
    best = min((fit(model, [record], windows=True, max_iterations=15) for model in trials), key=lambda f: f.cost)
    return judge(record, best.model).errors.window_rms, best.model.number("gravity_load.level_pct")


def runs_of(found: Diagnosis, told: Mapping[str, Any]) -> list[Run]:
    """Every run in the order of its power."""
    groups: list[tuple[Sequence[Record], Sequence[Judgement], Sequence[Judgement]]] = [
        (found.train, found.declared.judgements, found.final.judgements),
        (found.holdout, found.before_holdout, found.after_holdout),
    ]
    rows = [row for group in groups for row in zip(*group, strict=True)]

    def run(item: tuple[tuple[Record, Judgement, Judgement], Mapping[str, Any]]) -> Run:
        (record, before, after), log = item
        power, end = float(record.excitation.duties_pct[-1]), record.seconds
        speeds = [slope(record, y, 2.0, end) / power for y in (record.y, before.simulated, after.simulated)]
        early, late = slope(record, record.y, 2.0, 8.0), slope(record, record.y, end - 6.0, end)
        drift_pct = 100.0 * (late / early - 1.0)
        return Run(power, log, speeds[0], speeds[1], speeds[2], drift_pct, own_lag(record), *own_ripple(record))

    return sorted(each(run, list(zip(rows, told["logs"], strict=True))), key=lambda r: r.power_pct)


def pictures(found: Diagnosis, told: Mapping[str, Any], runs: Sequence[Run]) -> None:
    """Errors of every run, one held-out run and its first second, and the steady speed over the power."""
    (shown,) = [s for s in series_of(found) if s.title == SHOWN]
    start = replace(begun(shown, 1.0), title=f"{shown.title}, first second", duty_pct=None)
    points = {
        label: (np.array([r.power_pct for r in chosen]), np.array([r.speed for r in chosen]))
        for label, chosen in (
            ("measured, fitted", [r for r in runs if not r.held_out]),
            ("measured, held out", [r for r in runs if r.held_out]),
        )
    }
    speed = CurvePlot(
        title="Steady speed over power",
        x_label="power (%)",
        y_label="speed per percent of power (deg/s)",
        x=np.array([r.power_pct for r in runs]),
        lines={
            told["final"]["model"]: np.array([r.speed_after for r in runs]),
            told["declared"]["model"]: np.array([r.speed_before for r in runs]),
        },
        points=points,
    )
    logs = sorted(told["logs"], key=lambda log: str(log["file"]))
    save("errors", plot_residual_bars(logs, told["output_unit"]))
    save("run", plot_series(shown))
    save("start", plot_series(start))
    save("speed", plot_curve(speed))


def run_table(runs: Sequence[Run]) -> str:
    head = ["power", "before, whole", "windows", "after, whole", "windows", "floor, whole", "windows"]
    rows = [
        [
            f"{r.power_pct:g} %" + (", held out" if r.held_out else ""),
            *(figure for stage in ("before", "after", "floor") for figure in pair(r.told[stage])),
            f"{r.off_pct:+.2f} %",
            f"{r.drift_pct:+.2f} %",
            f"{1e3 * r.own_lag_s:.0f} ms",
            words.number(r.own_ripple_rms, 3),
            f"{r.own_ripple_pct:.2f} %",
        ]
        for r in runs
    ]
    return table([*head, "speed off", "drift", "own lag", "own ripple", "its size"], rows)


def facts(told: Mapping[str, Any], runs: Sequence[Run]) -> dict[str, str]:
    """The numbers in the text."""
    clear = [r for r in runs if r.power_pct >= CLEAR_PCT]
    changes = [(a, b, 100.0 * (b.speed / a.speed - 1.0)) for a, b in zip(clear[:-1], clear[1:], strict=True)]
    jumps = [f"from {a.power_pct:g} to {b.power_pct:g} % by {c:+.1f} %" for a, b, c in changes if abs(c) >= JUMP_PCT]
    others = max(abs(c) for _, _, c in changes if abs(c) < JUMP_PCT)
    worst = max(runs, key=lambda r: abs(r.off_pct))
    drift = max(clear, key=lambda r: abs(r.drift_pct))
    lag = told["final"]["parameters"]["linear.tau_s"]
    low, high = (f"{1e3 * bound:.0f}" for bound in lag["ci95"])
    held_out = {key: told[key]["holdout"]["window_rms"] for key in ("after", "floor")}
    own = [r.own_ripple_rms / r.told["floor"]["window_rms"] for r in clear]
    return {
        **common(told),
        "runs": run_table(runs),
        "jumps": words.listed(jumps),
        "others": f"{others:.1f}",
        "off_rms": f"{np.sqrt(np.mean([r.off_pct**2 for r in runs])):.2f}",
        "off_worst": f"{worst.off_pct:+.1f}",
        "off_worst_at": f"{worst.power_pct:g}",
        "drift": f"{drift.drift_pct:+.2f}",
        "drift_at": f"{drift.power_pct:g}",
        "windows": f"{held_out['after'] / held_out['floor']:.1f}",
        "own_ratio": f"{np.mean(own):.2f}",
        "lag": f"{1e3 * lag['value']:.0f}",
        "lag_interval": f"{low} .. {high}",
        "lag_low": f"{1e3 * min(r.own_lag_s for r in clear):.0f}",
        "lag_high": f"{1e3 * max(r.own_lag_s for r in clear):.0f}",
    }


def section(folder: Path) -> dict[str, str]:
    """Diagnoses the runs, draws the pictures and gives the words of the section."""

    def tables(powers: range) -> list[Path]:
        return [folder / f"power_{power:03d}.csv" for power in powers]

    found = diagnose(tables(FIT), tables(JUDGE), "linear", table_map=MAP, say=print)
    told = to_json(found)
    runs = runs_of(found, told)
    pictures(found, told, runs)
    return facts(told, runs)
