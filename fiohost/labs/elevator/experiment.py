"""The lab itself: every controller of the text on the model and on a target, then a ride by buttons."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

from fiohost.bench.loop import Bench, Progress
from fiohost.labs.elevator.buttons import Press, parse_presses
from fiohost.labs.elevator.car import MOTOR, Design, Move, Record, car_model, moves
from fiohost.labs.elevator.parts import TEXTS_LOAD_NM, Parts, parts_table
from fiohost.labs.elevator.ride import ByButtons, Demand, Ride, ideal, on_model, record_of, up_and_down
from fiohost.labs.play import furniture
from fiohost.labs.result import LabResult

TITLE = "Elevator (control lab appendix, section D-2)"
DEFAULT_PRESSES = "up@1,up@3.5,up@6:0.7,up@10:0.7,up@14,down@16.5:0.7,down@20.5,down@23:0.7,down@27:0.7"
ON = ("ideal", "model", "target")
TEXT_LIMIT_A = 1.0  # of the ideal model, as in the text's Fig. D-39
SMALL, SMALL_SHARES = 0.7, (1.0, 0.8, 0.6)  # of the current's limit, and of the power that reaches so far
TEXTS_CHOICE = Design(5.0, power_pct=40.0)  # section D-2-6


@dataclass(frozen=True)
class Plan:
    """What is to be done: gains in V/rad, V/(rad s), V s/rad, powers in percent, the volts of the target's full duty.

    ``current_limit_A`` is that of model and target alike, None for none; the ideal model has the text's.
    """

    gains: Sequence[float] = (2.0, 3.0, 5.0)
    integral_gains: Sequence[float] = (0.1, 0.2, 0.3)
    integral_with: float = 2.0
    powers_pct: Sequence[float] = (40.0, 60.0, 80.0)
    power_with: float = 5.0
    derivative_gains: Sequence[float] = (0.1, 0.2, 0.3)
    derivative_with: float = 5.0
    ride: Design = TEXTS_CHOICE
    presses: Sequence[Press] = parse_presses(DEFAULT_PRESSES)
    current_limit_A: float | None = TEXT_LIMIT_A
    full_scale_V: float = MOTOR.supply_V
    parts: Parts = Parts()  # noqa: RUF009


class Run(NamedTuple):
    """One design, and what it did on the model and on the target; ``ideal`` only of the text's own moves."""

    design: Design
    model: Record
    target: Record
    ideal: Record | None = None

    def moves(self) -> Iterator[tuple[str, Move]]:
        """Every move with where it was made, one of ``ON``."""
        for on in ON:
            record = getattr(self, on)
            for move in moves(record) if record is not None else ():
                yield on, move


@dataclass(frozen=True)
class Series:
    """One table of the text: its designs by the gain in which they differ, and their runs by the same."""

    key: str
    title: str
    designs: Mapping[str, Design]
    runs: dict[str, Run] = field(default_factory=dict)
    table: str = ""  # the readings file with the text's own rows


def experiment(bench: Bench, plan: Plan, folder: Path, said: Callable[[str], None] = lambda text: None) -> LabResult:
    """Run the plan on a bench; logs go into *folder*. Raises FiohostError."""
    from fiohost.labs.elevator import tell
    from fiohost.labs.elevator.search import best_design

    limit_A = shared_limit(bench, plan)
    found = best_design(car_model(current_limit_A=limit_A), bench.sample_time_s, 360.0 / bench.counts_per_rev)
    series = [
        Series("p", "P control (tables D-12, D-13)", {f"kp {kp:g}": Design(kp) for kp in plan.gains}, table="nxt_d13"),
        Series(
            "pi",
            f"PI control, kp {plan.integral_with:g} (table D-14)",
            {f"ki {ki:g}": Design(plan.integral_with, ki) for ki in plan.integral_gains},
            table="nxt_d14",
        ),
        Series(
            "power",
            f"Limited power, kp {plan.power_with:g} (table D-15)",
            {f"{power:g} %": Design(plan.power_with, power_pct=power) for power in plan.powers_pct},
            table="nxt_d15",
        ),
        Series(
            "pd",
            f"PD control, kp {plan.derivative_with:g} (section D-2-5)",
            {f"kd {kd:g}": Design(plan.derivative_with, kd_V_s_per_rad=kd) for kd in plan.derivative_gains},
        ),
        Series("found", "Found on the model", {"found": found} if found else {}),
    ]
    files = {}
    for part in series:
        for number, (name, design) in enumerate(part.designs.items(), start=1):
            said(f"up and down: {design.label}")
            path = folder / f"elevator_{part.key}_{number}.csv"
            run = _run(bench, plan, design, up_and_down, path)
            part.runs[name] = run._replace(ideal=ideal(MOTOR, design, TEXT_LIMIT_A))
            files[f"log of {design.label}"] = str(path)
    for number, design in enumerate(small_moves(plan), start=1):
        said(f"up and down, little power: {design.label}")
        path = folder / f"elevator_small_{number}.csv"
        _run(bench, plan, design, up_and_down, path)
        files[f"log of a small move, {design.label}"] = str(path)
    said(f"ride by buttons: {plan.ride.label}, {len(plan.presses)} presses")
    path = folder / "elevator_ride.csv"
    ride = _run(bench, plan, plan.ride, ByButtons(plan.presses), path)
    told = tell.ride(ride, plan.presses)
    return LabResult(
        name="elevator",
        title=TITLE,
        target=bench.transport.name,
        tables=(parts_table(plan.parts), *(tell.table(part) for part in series if part.runs), told.table),
        answers=(*tell.answers(series, limit_A), told.answer),
        notes=tell.notes(limit_A, plan.current_limit_A),
        values={
            "criteria": tell.CRITERIA,
            "current_limit_A": limit_A,
            **_of_parts(plan.parts),
            **{part.key: tell.values(part) for part in series},
            "ride": told.values,
        },
        figures={**{f"elevator_{s.key}": partial(tell.draw, s) for s in series if s.runs}, "elevator_ride": told.draw},
        files={**files, "log of the ride": str(path)},
    )


def small_moves(plan: Plan) -> list[Design]:
    """Moves with so little power that no limit of the current cuts them: their logs say what a linear model lacks.

    The current is largest where the car stands; three powers, as friction and a lost voltage differ by the speed.
    """
    amperes = TEXT_LIMIT_A if plan.current_limit_A is None else plan.current_limit_A
    most_pct = min(100.0 * SMALL * amperes * MOTOR.R_ohm / plan.full_scale_V, 100.0)
    return [Design(plan.power_with, power_pct=round(share * most_pct, 1)) for share in SMALL_SHARES]


def live(bench: Bench, plan: Plan, demand: ByButtons, folder: Path, progress: Progress) -> LabResult:
    """Only the ride, by a demand that ends itself. Raises FiohostError."""
    from fiohost.labs.elevator import tell

    path = folder / "elevator_ride.csv"
    told = tell.ride(_run(bench, plan, plan.ride, demand, path, progress), demand.presses)
    return LabResult(
        name="elevator",
        title=f"{TITLE}: live ride",
        target=bench.transport.name,
        tables=(told.table,),
        answers=(told.answer,),
        notes=tell.notes(shared_limit(bench, plan), plan.current_limit_A),
        values={"criteria": tell.CRITERIA, "ride": told.values},
        figures={"elevator_ride": told.draw},
        files={"log of the ride": str(path)},
    )


def _run(bench: Bench, plan: Plan, design: Design, demand: Demand, path: Path, progress: Progress | None = None) -> Run:
    """One demand on the target, then the same on the model, whose full duty is its own."""
    settings = design.settings(plan.full_scale_V)
    metadata = {"experiment": "elevator", "loop": "closed", **settings.describe()}
    ride = Ride(settings.law(bench.sample_time_s), demand, bench.sample_time_s)
    limit_A, supply = shared_limit(bench, plan), furniture(bench)
    if supply is not None:
        supply.limit_current(limit_A)
    try:
        log = bench.play(ride, path, metadata, progress)
    finally:
        if supply is not None:
            supply.limit_current(None)
    return Run(design, on_model(MOTOR, design.settings(MOTOR.supply_V), log, limit_A), record_of(log))


def _of_parts(parts: Parts) -> dict[str, float]:
    """The elevator's constants from its parts, for programs."""
    load = TEXTS_LOAD_NM if parts == Parts() else parts.load_Nm
    return {"J_total_kgm2": parts.J_total_kgm2, "load_Nm": parts.load_Nm, "B_Nms": parts.B_Nms(load)}


def shared_limit(bench: Bench, plan: Plan) -> float | None:
    """The current limit of model and target: that of the plan where the target has one, else none."""
    return None if furniture(bench) is None else plan.current_limit_A
