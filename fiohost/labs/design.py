"""PD control to a specification: gains found in simulation, then run on the target, side by side.

Squares of 170/190, 135/225 and 90/270 degrees (INC451 lab 2, section 2.4.3), with the limit of the duty, friction or
deadband, its compensation, the counts of the encoder and the tick of delay in both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fiohost.bench.experiment import Experiment
from fiohost.bench.log import Log
from fiohost.bench.loop import COMMAND_DELAY_TICKS, Bench
from fiohost.bench.profile import BenchProfile
from fiohost.bench.signals import Square
from fiohost.control.closed_loop import LoopRun, Plant, run_loop
from fiohost.control.design import Design, design, with_deadband
from fiohost.control.settings import ControlSettings
from fiohost.control.specification import Specification, StepOutcome, judge
from fiohost.estimation.logs import identify
from fiohost.labs.identification import KP, explained, measured_profile, run_and_fit
from fiohost.labs.result import Answer, Cell, LabResult, Table
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SQUARES_DEG = ((170.0, 190.0), (135.0, 225.0), (90.0, 270.0))
PERIOD_S, PERIODS = 4.0, 3
FIGURES = (("overshoot_pct", "overshoot (%)"), ("settling_s", "settling (s)"), ("error_deg", "error (deg)"))


@dataclass(frozen=True)
class Both:
    """One square, run and simulated on the same ticks, and the outcomes of its steps, the worst of each figure."""

    low_deg: float
    high_deg: float
    log: Log
    simulated: LoopRun
    measured_steps: Sequence[StepOutcome]
    simulated_steps: Sequence[StepOutcome]

    @property
    def name(self) -> str:
        return f"{self.low_deg:g}/{self.high_deg:g} deg"


def design_lab(
    bench: Bench,
    folder: Path,
    asked: Specification | None = None,
    kind: str = "pd",
    profile: BenchProfile | None = None,
    model: Model | None = None,
) -> LabResult:
    """Design on a model (without one, a motor with friction is identified first), then run. Raises FiohostError."""
    known = profile or measured_profile(bench)
    notes = []
    if model is None:
        loop = ControlSettings(kp_pct_per_deg=KP).with_compensation(*known.compensation_pct)
        log, friction = run_and_fit(bench, folder, loop)
        model = friction.model if explained(friction) else identify(log).model
        if not explained(friction):
            notes.append(f"dry friction does not explain {log.path}: designed on the linear fit and the deadband")
    motor = with_deadband(model, known.u_plus_pct, known.u_minus_pct)
    spec = asked or Specification()
    count_deg = 360.0 / bench.counts_per_rev
    found = design(
        motor, kind, overshoot_pct=spec.overshoot_pct, settling_s=spec.settling_s, sse_deg=spec.sse_deg,
        band_pct=spec.band_pct, compensation_pct=known.compensation_pct, sample_time_s=bench.sample_time_s,
        delay_s=COMMAND_DELAY_TICKS * bench.sample_time_s, quantum_deg=count_deg,
        steps_deg=[high - low for low, high in SQUARES_DEG],
    )  # fmt: skip
    squares = [_run(bench, folder, found, low, high) for low, high in SQUARES_DEG]
    controller = folder / "design_controller.toml"
    found.settings.save(controller, f"designed by fiohost lab design for {bench.transport.name}")
    files = {"controller": str(controller)} | {f"log {both.name}": str(both.log.path) for both in squares}
    return _result(bench, replace(found, notes=(*found.notes, *notes)), squares, files)


def _run(bench: Bench, folder: Path, found: Design, low: float, high: float) -> Both:
    square = Square(duration_s=PERIODS * PERIOD_S, low=low, high=high, period_s=PERIOD_S)
    name = f"design_{low:g}_{high:g}"
    plan = Experiment(name, reference=(square,), control=found.settings, sample_time_s=bench.sample_time_s)
    log = bench.run(plan, folder / f"{name}.csv")
    loop = found.settings.loop(found.sample_time_s, found.delay_s, found.quantum_deg)
    begin = Start(float(log.output[0]) + 0.5 * found.quantum_deg, 0.0)
    run = run_loop(Plant.of(found.model), loop, plan.levels()[0], begin)
    measured = _steps(log.time_s, log.columns["ref_deg"], log.output, log.duty_pct, found)
    return Both(low, high, log, run, measured, _steps(run.time_s, run.ref_deg, run.angle_deg, run.duty_pct, found))


def _steps(
    time_s: np.ndarray, ref_deg: np.ndarray, y_deg: np.ndarray, duty_pct: np.ndarray, found: Design
) -> list[StepOutcome]:
    """The outcome of every step after the first level."""
    edges = [int(k) for k in np.flatnonzero(np.diff(ref_deg)) + 1]
    return [
        judge(
            time_s[a:b] - time_s[a], y_deg[a:b], duty_pct[a:b], float(y_deg[a]), float(ref_deg[a]),
            found.asked.band_pct, found.quantum_deg,
        )
        for a, b in zip(edges, [*edges[1:], len(time_s)], strict=True)
    ]  # fmt: skip


def _worst(steps: Sequence[StepOutcome], name: str) -> float:
    return max(float(getattr(one, name)) for one in steps)


def _result(bench: Bench, found: Design, squares: Sequence[Both], files: Mapping[str, str]) -> LabResult:
    asked = found.asked
    columns = ["square", "by", *(label for _, label in FIGURES), "rise (s)", "reversals (1/s)", "meets it"]
    rows: list[Sequence[Cell]] = []
    for both in squares:
        for who, steps in (("simulation", both.simulated_steps), ("target", both.measured_steps)):
            figures = [_worst(steps, name) for name, _ in (*FIGURES, ("rise_s", ""), ("reversals_per_s", ""))]
            rows.append((both.name, who, *figures, "yes" if all(one.meets(asked) for one in steps) else "NO"))
    rows.append(("asked for", "below", asked.overshoot_pct, asked.settling_s, asked.sse_deg, None, None, None))
    gains = found.settings.describe_numbers()
    gain_rows = [(name, value) for name, value in gains.items()]
    met = all(one.meets(asked) for both in squares for one in both.measured_steps)
    kind = found.settings.kind.upper()
    return LabResult(
        name="design",
        title=f"{kind} control to a specification, designed on {found.model.expression}",
        target=bench.transport.name,
        tables=(
            Table("The controller", ("setting", "value"), gain_rows),
            Table(f"Worst of {len(squares[0].measured_steps)} steps of each square", tuple(columns), rows, (0, 1)),
        ),
        answers=_answers(found, squares, met),
        notes=tuple(found.notes),
        values={
            **found.to_json(),
            "met_on_target": met,
            "squares": [
                {
                    "low_deg": both.low_deg,
                    "high_deg": both.high_deg,
                    "simulated": [vars(one) for one in both.simulated_steps],
                    "measured": [vars(one) for one in both.measured_steps],
                    "difference_rms_deg": _difference(both),
                }
                for both in squares
            ],
        },
        figures={f"design_{both.low_deg:g}_{both.high_deg:g}": _drawn(both, found) for both in squares},
        files=files,
    )


def _difference(both: Both) -> float:
    """Measured minus simulated angle, rms over the rows of the log."""
    at = np.searchsorted(both.simulated.time_s, both.log.time_s - 1e-9)
    return float(np.sqrt(np.mean((both.log.output - both.simulated.angle_deg[at]) ** 2)))


def _answers(found: Design, squares: Sequence[Both], met: bool) -> tuple[Answer, ...]:
    asked = found.asked
    kind = found.settings.kind.upper()
    if found.feasible:
        design_says = f"Yes: no step of the simulation comes closer than {_room(found.found, asked)} to a limit"
        design_says += ", and it holds on models whose gain, lag, friction and delay are off." if found.robust else "."
    elif not found.nearest:
        design_says = f"No {kind} controller was found that does: with none does the loop come to rest."
    else:
        near = found.nearest[0].asked
        design_says = (
            f"No {kind} controller was found that does; the nearest that can be met is overshoot < "
            f"{near.overshoot_pct:g} %, settling < {near.settling_s:g} s, error < {near.sse_deg:g} deg."
        )
    failing = [both.name for both in squares if not all(one.meets(asked) for one in both.measured_steps)]
    on_target = f"Yes, in all {sum(len(b.measured_steps) for b in squares)} steps." if met else (
        f"Not in the squares {', '.join(failing)}."
    )  # fmt: skip
    apart = "; ".join(
        f"{both.name}: {_difference(both):.2g} deg rms, settling {_worst(both.simulated_steps, 'settling_s'):.3f} s "
        f"simulated and {_worst(both.measured_steps, 'settling_s'):.3f} s measured"
        for both in squares
    )
    full = [both.name for both in squares if np.mean(np.abs(both.log.duty_pct) >= found.settings.limit_pct) > 0.0]
    limit = f"{' and '.join(full)}: there the motor's speed decides, not the gains" if full else "none of the squares"
    return (
        Answer("Does the design meet the specification in simulation?", design_says),
        Answer("Does it on the target?", on_target),
        Answer("How close is the simulation?", apart + "."),
        Answer("Where does the duty reach its limit?", f"In {limit}."),
    )


def _room(steps: Sequence[StepOutcome], asked: Specification) -> str:
    return f"{100.0 * (1.0 - max(max(one.ratios(asked)) for one in steps)):.0f} %"


def _drawn(both: Both, found: Design) -> Callable[[], Figure]:
    return lambda: _plot(both, found)


def _plot(both: Both, found: Design) -> Figure:
    """A step up and a step down, angle and duty, simulated and measured."""
    from fiohost.report.design import Square as Drawn
    from fiohost.report.design import plot_squares

    log, run = both.log, both.simulated
    rows = []
    for title, first in (("up", 0.5 * PERIOD_S), ("down", PERIOD_S)):
        inside = (log.time_s >= first - 0.05) & (log.time_s <= first + 2.0 * found.asked.settling_s + 0.2)
        beside = (run.time_s >= first - 0.05) & (run.time_s <= first + 2.0 * found.asked.settling_s + 0.2)
        rows.append(
            Drawn(
                f"{both.name}, {title}",
                (log.time_s[inside] - first, log.columns["ref_deg"][inside]),
                [("measured", log.time_s[inside] - first, log.output[inside]),
                 ("simulated", run.time_s[beside] - first, run.angle_deg[beside])],
                [("measured", log.time_s[inside] - first, log.duty_pct[inside]),
                 ("simulated", run.time_s[beside] - first, run.duty_pct[beside])],
            )
        )  # fmt: skip
    return plot_squares(rows, f"{found.settings.kind.upper()} on {both.name}", found.asked)
