"""What the runs of the elevator say: tables, values, answers to the text's questions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import exp
from typing import TYPE_CHECKING, Any

import numpy as np

from fiohost.labs.elevator.buttons import Press
from fiohost.labs.elevator.car import (
    DRUM_CM,
    LOAD_NM,
    MOST_ERROR_CM,
    MOST_OVERSHOOT_PCT,
    MOST_SETTLING_S,
    MOTOR,
    TOP_FLOOR,
    Design,
    Move,
    faults_of,
    floor_of,
    moves,
)
from fiohost.labs.elevator.experiment import ON, TEXT_LIMIT_A, Run, Series
from fiohost.labs.elevator.ride import STAY_S, ideal
from fiohost.labs.printed import Printed, printed
from fiohost.labs.result import Answer, Cell, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("on", "PO (%)", "settle (s)", "rise (s)", "error (cm)", "meets")
CRITERIA = {"overshoot_pct": MOST_OVERSHOOT_PCT, "error_cm": MOST_ERROR_CM, "settling_s": MOST_SETTLING_S}


def table(part: Series) -> Table:
    """A series as the text prints it: up first, then down; model and target one below the other."""
    rows: list[list[Cell]] = []
    for name, run in part.runs.items():
        rows += [[move.way, name, on, *_cells(move)] for on, move in run.moves()]
        for text in _printed(part, run.design):
            error = text.error or 0.0
            faults = faults_of(text.overshoot_pct, error, text.settling_5_s)
            rows.append([str(text.settings["way"]), name, text.who, text.overshoot_pct, text.settling_5_s, text.rise_s,
                         error, "no" if faults else "yes"])  # fmt: skip
    rows.sort(key=lambda row: row[0] == "down")
    return Table(part.title, ("way", "gain", *COLUMNS), rows, given=(0, 1, 2))


def _printed(part: Series, design: Design) -> list[Printed]:
    """The text's own rows for a design."""
    rows = printed(part.table) if part.table else ()
    wanted: dict[str, float] = {"kp": design.kp_V_per_rad}
    wanted |= {"ki": design.ki_V_per_rad_s} if part.key == "pi" else {}
    wanted |= {"power_pct": design.power_pct} if part.key == "power" else {}
    return [row for row in rows if row.has(**wanted)]


def values(part: Series) -> list[dict[str, Any]]:
    return [
        {
            "kp_V_per_rad": run.design.kp_V_per_rad,
            "ki_V_per_rad_s": run.design.ki_V_per_rad_s,
            "kd_V_s_per_rad": run.design.kd_V_s_per_rad,
            "power_pct": run.design.power_pct,
            "move": move.way,
            "on": on,
            **_figures(move),
        }
        for run in part.runs.values()
        for on, move in run.moves()
    ]


def notes(limit_A: float | None, asked_A: float | None) -> tuple[str, ...]:
    limit = "no limit of the current" if limit_A is None else f"a current of {limit_A:g} A at most"
    said: tuple[str, ...] = (
        f"Model: {MOTOR.source}, load {LOAD_NM:g} N m against upward motion, full duty {MOTOR.supply_V:g} V, {limit}, "
        f"as the target. Ideal is the text's block diagram: no ticks, no delay, no counts, {MOTOR.supply_V:g} V and "
        f"{TEXT_LIMIT_A:g} A, the step at once.",
        "Overshoot (PO) is of the response's own final value (Eq. D-30), settling to 5 % and rise from 10 to 90 % are "
        "of the height that was asked for; a target is read at 0.5 deg, 0.012 cm. Height is zero where the car stands "
        "when a run begins.",
    )
    if limit_A is None and asked_A is not None:
        said += (f"Nothing limits the target's current, so neither it nor the model has the limit of {asked_A:g} A.",)
    return said


def answers(series: Sequence[Series], limit_A: float | None) -> list[Answer]:
    p, pi, power, pd, found = series
    return [
        Answer("Which P gains meet overshoot 5 %, error 1 mm and settling 1 s?", _meeting(p)),
        Answer("What leaves the error, and how large is it?", _droop(p)),
        Answer("Is the model good enough, and would more viscous friction make it better?", _model_error(p, limit_A)),
        Answer("Which integral gain takes the error away?", _integral(pi)),
        Answer("What does limiting the power do?", _power(power)),
        Answer("What does a derivative do instead?", _derivative(pd)),
        Answer("Does the text's block diagram give the text's figures?", _text(p)),
        Answer("Which design meets every criterion both ways?", _found(found)),
    ]


def _meeting(part: Series) -> str:
    said = []
    for run in part.runs.values():
        made = list(run.moves())
        made = [(on, move) for on, move in made if on in ON[1:]]
        faults = {on: sorted({fault for where, move in made if where == on for fault in move.faults}) for on, _ in made}
        verdicts = [f"fails by {' and '.join(why)}" if why else "meets them" for why in faults.values()]
        same = len(set(verdicts)) == 1
        where = ["on both"] if same else [f"on the {on}" for on in faults]
        told = (f"{verdict} {on}" for verdict, on in zip(verdicts, where, strict=False))
        said.append(f"{run.design.label} {' and '.join(told)}")
    return "; ".join(said) + "." if said else "None was asked for."


def _droop(part: Series) -> str:
    said = []
    for run in part.runs.values():
        kp = run.design.kp_V_per_rad
        computed = DRUM_CM * LOAD_NM * MOTOR.R_ohm / (MOTOR.Kt_Nm_per_A * kp)
        measured = np.mean([abs(move.figures.steady_state_error) for on, move in run.moves() if on == "target"])
        said.append(f"kp {kp:g}: {computed:.3f} cm computed, {measured:.3f} cm on the target")
    return (
        "The car's weight: at rest the motor must hold T = 0.017 N m, which costs T R/(Ki KP) radians of error. "
        + "; ".join(said)
        + ". Dry friction, which this model has not, may hold the car anywhere within a band about that."
    )


def _model_error(part: Series, limit_A: float | None) -> str:
    apart = [
        abs(model.figures.overshoot_pct - target.figures.overshoot_pct)
        for run in part.runs.values()
        for (_, model), (_, target) in zip(_of(run, "model"), _of(run, "target"), strict=False)
    ]
    thicker = replace(MOTOR, B_Nms=2.0 * MOTOR.B_Nms)
    changed = []
    for run in part.runs.values():
        before, after = (next(moves(ideal(motor, run.design, TEXT_LIMIT_A))) for motor in (MOTOR, thicker))
        changed.append(f"{before.figures.overshoot_pct:.1f} to {after.figures.overshoot_pct:.1f} %")
    return (
        f"Overshoots of model and target differ by at most {max(apart, default=0.0):.2g} points. Twice the viscous "
        f"friction would change the ideal model's upward overshoot at these gains from {', '.join(changed)}."
    )


def _integral(part: Series) -> str:
    said = []
    for run in part.runs.values():
        errors = {move.way: move.figures.steady_state_error for on, move in run.moves() if on == "target"}
        share = 1.0 - exp(-STAY_S * run.design.ki_V_per_rad_s / run.design.kp_V_per_rad)
        shown = ", ".join(f"{error:+.3f} cm {way}" for way, error in errors.items())
        said.append(f"ki {run.design.ki_V_per_rad_s:g}: {shown} (the slow pole goes {100.0 * share:.0f} % of its way)")
    return (
        f"On the target, {STAY_S:g} s after each move: "
        + "; ".join(said)
        + ". What the integral gathers while the car is under way stays in it: upward that helps, downward it must "
        "first be taken back. In table D-14 the smallest upward error belongs to ki 0.1, though the text names 0.3."
    )


def _power(part: Series) -> str:
    said = []
    for run in part.runs.values():
        of_target = [move.figures for on, move in run.moves() if on == "target"]
        most, slowest = max(f.overshoot_pct for f in of_target), max(f.settling_5_s for f in of_target)
        said.append(f"{run.design.power_pct:g} %: overshoot up to {most:.1f} %, settling up to {slowest:.2f} s")
    return (
        "; ".join(said)
        + ". Less power, less overshoot, slower: the car arrives at a lower speed. The model shows it with constant "
        "viscous friction, so friction that grows at low power, the text's reason, is not needed for it."
    )


def _derivative(part: Series) -> str:
    said = []
    for run in part.runs.values():
        of_target = [move for on, move in run.moves() if on == "target"]
        most, slowest = (max(getattr(m.figures, key) for m in of_target) for key in ("overshoot_pct", "settling_5_s"))
        met = "all criteria met" if not any(m.faults for m in of_target) else "not all criteria met"
        said.append(
            f"kd {run.design.kd_V_s_per_rad:g}: overshoot up to {most:.1f} %, settling up to {slowest:.2f} s, {met}"
        )
    return (
        "; ".join(said) + ". It damps the way there and leaves the steady error as it is."
        if said
        else "None was asked for."
    )


def _text(part: Series) -> str:
    said = []
    for run in part.runs.values():
        up = next((move for on, move in run.moves() if on == "ideal" and move.way == "up"), None)
        text = next((row for row in _printed(part, run.design) if row.table == "D-12"), None)
        if up is not None and text is not None:
            f = up.figures
            said.append(
                f"kp {run.design.kp_V_per_rad:g}: {f.overshoot_pct:.1f} %, {f.settling_5_s:.3f} s, {f.rise_s:.3f} s, "
                f"{f.steady_state_error:.2f} cm; printed {text.overshoot_pct:g}, {text.settling_5_s:g}, "
                f"{text.rise_s:g}, {text.error:g}"
            )
    return ". ".join(said) + "." if said else "None of its gains was asked for."


def _found(part: Series) -> str:
    if not part.runs:
        return "None of those that were tried on the model."
    (run,) = part.runs.values()
    kept = all(not move.faults for on, move in run.moves() if on == "target")
    found = f"The fastest found on the model, with a tenth to spare: {run.design.label}."
    return f"{found} On the target it {'meets' if kept else 'does NOT meet'} them all."


@dataclass(frozen=True)
class ToldRide:
    """A ride by buttons, told."""

    table: Table
    answer: Answer
    values: dict[str, Any]
    draw: Callable[[], Figure]


def ride(run: Run, presses: Sequence[Press]) -> ToldRide:
    made = sorted(run.moves(), key=lambda pair: (round(pair[1].begin_s, 1), pair[0]))
    rows = [[round(m.begin_s, 2), f"{floor_of(m.from_cm)} to {floor_of(m.to_cm)}", on, *_cells(m)] for on, m in made]
    asked = run.target.ref_cm[np.flatnonzero(np.diff(run.target.ref_cm, prepend=np.nan))]
    floors = [floor_of(height) for height in asked]
    of_target = [m for on, m in made if on == "target"]
    short = [m for m in of_target if m.floors == 1]
    long = [m for m in of_target if m.floors > 1]
    text = (
        f"{len(presses)} presses; floors {min(floors)} to {max(floors)} were asked for, none outside 0 to {TOP_FLOOR}. "
        f"On the target {_met(short)} of one floor and {_met(long)} of more meet the criteria."
    )
    if any("settling" in m.faults for m in long):
        most = max(m.figures.settling_5_s for m in long)
        text += f" More than one floor takes up to {most:.2f} s at {run.design.power_pct:g} % power; "
        text += "the text's second is for one floor."
    return ToldRide(
        Table(f"Ride by buttons, {run.design.label} (Fig. D-50)", ("at (s)", "floors", *COLUMNS), rows, (0, 1, 2)),
        Answer("Does the car reach the floors that the buttons ask for, within the criteria?", text),
        {
            "floors_asked": floors,
            "moves": [
                {"begin_s": m.begin_s, "from_floor": floor_of(m.from_cm), "to_floor": floor_of(m.to_cm), "on": on}
                | _figures(m)
                for on, m in made
            ],
        },
        partial(_draw_ride, run, tuple(presses)),
    )


def draw(part: Series) -> Figure:
    from fiohost.labs.elevator.figures import plot_series

    return plot_series(part)


def _draw_ride(run: Run, presses: Sequence[Press]) -> Figure:
    from fiohost.labs.elevator.figures import plot_ride

    return plot_ride(run, presses)


def _of(run: Run, where: str) -> list[tuple[str, Move]]:
    return [(on, move) for on, move in run.moves() if on == where]


def _met(made: Sequence[Move]) -> str:
    return f"{sum(not m.faults for m in made)} of {len(made)} moves"


def _cells(move: Move) -> list[float | str]:
    f = move.figures
    shown = (round(f.overshoot_pct, 1), round(f.settling_5_s, 3), round(f.rise_s, 3), round(f.steady_state_error, 3))
    return [*shown, "no" if move.faults else "yes"]


def _figures(move: Move) -> dict[str, float | bool]:
    f = move.figures
    return {
        "overshoot_pct": f.overshoot_pct,
        "settling_5_s": f.settling_5_s,
        "rise_s": f.rise_s,
        "error_cm": f.steady_state_error,
        "meets": not move.faults,
    }
