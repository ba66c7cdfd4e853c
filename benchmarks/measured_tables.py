"""The measurements that the control lab appendix prints beside its simulations: the text's model before and after.

The folder holds the printed figures as tables (``table_d7_position_no_load.csv`` ...), ``parameters.csv`` and
``facts.csv``; the text is F. Golnaraghi, B. C. Kuo, Automatic Control Systems, Appendix D.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from measured_page import save, table
from text_steady import steady_facts
from text_tables import DEG_PER_CM, LIMITS, PRINTED, declared, joined, load_Nm, off, simulate, with_full_power
from viscous import fitted_viscous

from fiohost.control.closed_loop import Plant
from fiohost.discover.tables.diagnose import diagnose_tables
from fiohost.discover.tables.fit import Rows, fit_tables
from fiohost.discover.tables.responses import Responses
from fiohost.discover.tables.settings import SETTINGS
from fiohost.discover.tables.starts import fit_declared
from fiohost.discover.tables.worth import Worth, left_out_rms, scatter_needed
from fiohost.labs.constants import TEXT
from fiohost.labs.tables import Judged, judge, plot_rows
from fiohost.motor.model import Model
from fiohost.report import words

LIFTED = ("d13", "d14_up", "d14_down", "d15_up", "d15_down")
UNITS = {"overshoot_pct": ("overshoot (%)", 1.0), "settling_5_s": ("settling (ms)", 1e3), "rise_s": ("rise (ms)", 1e3),
         "steady_state_error": ("error that stays (mm)", 10.0)}  # fmt: skip
EXPLAIN = ("backlash", "coulomb_friction")


@dataclass(frozen=True)
class Case:
    """One printed table judged; ``simulated`` are the text's own figures, one mapping a row, where it prints them."""

    name: str
    label: str
    motor: str
    responses: Responses
    judged: Judged
    viscous: tuple[Worth, Worth]
    simulated: Sequence[Mapping[str, float]] | None = None

    @property
    def before(self) -> float:
        return self.judged.diagnosis.found.declared.fit.rms

    @property
    def after(self) -> float:
        return self.judged.diagnosis.final.fit.rms

    def figures(self, stage: str) -> Sequence[Mapping[str, float]]:
        """Figures by row of the ``declared`` or the ``final`` model."""
        found = self.judged.diagnosis.found.declared if stage == "declared" else self.judged.diagnosis.final
        return found.fit.predicted


def judged(name: str, label: str, motor: str, responses: Responses, model: Model,
           simulated: Sequence[Mapping[str, float]] | None = None) -> Case:  # fmt: skip
    """Diagnose one table and fit the text's own explanations to it."""
    print(f"{label}:")
    found = judge(diagnose_tables([responses], model, from_file=True, say=print), EXPLAIN)
    viscous = tuple(fitted_viscous(responses, model, TEXT[motor], falling) for falling in (False, True))
    return Case(name, label, motor, responses, found, (viscous[0], viscous[1]), simulated)


def freed(case: Case) -> Worth:
    """Dry friction with the motor's gain and lag fitted too: the text's viscous friction may hold some of it."""
    dry = case.judged.asked[1].fit
    assert dry is not None
    model = replace(dry.model, fixed=dry.model.fixed - {"linear.gain_deg_s_per_pct", "linear.tau_s"})
    evidence = case.judged.diagnosis.evidence
    found = fit_tables(evidence.rows, model, looks=SETTINGS.looks)
    return Worth("dry friction, gain and lag", found, found.rms, left_out_rms(evidence, found))


def tables_of(data: Path, scratch: Path) -> dict[str, Responses]:
    """The measured rows of every printed table; powers with their row at 100 %."""
    found = {name: printed.read(data, scratch) for name, printed in PRINTED.items()}
    return {**found, "d15_up": with_full_power(found["d15_up"], found["d13"])}


def simulated_of(data: Path, scratch: Path) -> dict[str, Responses]:
    """The rows that the text simulated, by the name of the table."""
    return {name: p.read(data, scratch, p.simulated, f"{name}_simulated") for name, p in PRINTED.items() if p.simulated}


def cases_of(data: Path, scratch: Path) -> list[Case]:
    measured, text = tables_of(data, scratch), simulated_of(data, scratch)
    found = []
    for name, printed in PRINTED.items():
        own = [row.measured for row in text[name].rows] if name in text else None
        model = declared(data, printed.motor)
        found.append(judged(name, printed.label, printed.motor, measured[name], model, own))
    limited = PRINTED["d15_up"].read(data, scratch)  # its row at 100 % is among the gains
    every = joined("elevator", [limited if name == "d15_up" else measured[name] for name in LIFTED])
    return [*found, judged("elevator", "D-13 to D-15 together", "elevator", every, declared(data, "elevator"))]


def beside(rms: float, left_out: float | None) -> str:
    """An error and, in brackets, that on rows left out."""
    return f"{words.number(rms, 3)} ({words.DASH if left_out is None else words.number(left_out, 3)})"


def before_after(cases: Sequence[Case]) -> str:
    """The one table: errors in floors before and after, rows left out in brackets, beside the text's explanations."""
    rows = []
    for case in cases:
        found = case.judged.diagnosis.found
        names = [words.effect_words(step.effect) for step in found.steps]
        rows.append(
            [
                case.label,
                str(len(case.responses.rows)),
                words.DASH if case.simulated is None else words.number(off(case.responses, case.simulated), 3),
                words.number(case.before, 3),
                ", ".join(names) or "nothing",
                beside(case.after, found.final.left_out_rms),
                words.number(found.final.limit_rms, 3),
                *(beside(w.rms, w.left_out_rms) for w in (*case.judged.asked, freed(case), *case.viscous)),
                passing(case),
            ]
        )
    head = [
        "table",
        "rows",
        "text's simulation",
        "before",
        "named",
        "after",
        "chance may leave",
        "backlash",
        "dry friction",
        "dry friction, gain and lag free",
    ]
    return table([*head, "larger B", "B falling with power", "after would pass with a scatter of"], rows)


def passing(case: Case) -> str:
    """What readings would have to scatter for the final model to leave no more than chance."""
    final = case.judged.diagnosis.final
    needed = scatter_needed(final.fit.rms, final.limit_rms)
    floors = {f.name: f.floor for f in case.responses.figures}
    sizes = {"overshoot_pct": (1.0, "%"), "rise_s": (1e3, "ms"), "steady_state_error": (10.0, "mm")}
    shown = [(times * needed * floors[name], unit) for name, (times, unit) in sizes.items() if name in floors]
    return ", ".join(f"{words.number(size, 2)} {unit}" for size, unit in shown)


def steps_table(case: Case) -> str:
    """Errors of one case after every step."""
    found = case.judged.diagnosis.found
    stages = [("declared", found.declared), *((f"+ {words.effect_words(s.effect)}", s.stage) for s in found.steps)]
    rows = [[label, beside(stage.fit.rms, stage.left_out_rms)] for label, stage in stages]
    return table(["D-13 to D-15 together", "floors (left out)"], rows)


def by_figure(cases: Sequence[Case]) -> str:
    """Rms of every figure in its own unit: the text's simulation, before, after."""
    rows = []
    for case in cases:
        ways = {"text's simulation": case.simulated, "before": case.figures("declared"), "after": case.figures("final")}
        for way, figures in ways.items():
            if figures is not None:
                rows.append([case.label, way, *(rms_of(case.responses, figures, n, u) for n, (_, u) in UNITS.items())])
    return table(["table", "model", *(head for head, _ in UNITS.values())], rows)


def rms_of(responses: Responses, figures: Sequence[Mapping[str, float]], name: str, scale: float) -> str:
    if name not in [f.name for f in responses.figures]:
        return words.DASH
    left = [row.measured[name] - own[name] for row, own in zip(responses.rows, figures, strict=True)]
    return words.number(scale * float(np.sqrt(np.mean(np.square(left)))), 2)


def simulations(data: Path, scratch: Path) -> dict[str, str]:
    """The text's simulated rows made again: how far off under which limits, and every figure beside the printed one."""
    text = simulated_of(data, scratch)
    errors, figures = [], []
    for name in ("d7", "d9", "d13"):
        printed, responses = PRINTED[name], text[name]
        motor, load = TEXT[printed.motor], load_Nm(data, printed.motor)
        found = [
            [simulate(responses, i, motor, load, limit.limits) for i in range(len(responses.rows))] for limit in LIMITS
        ]
        errors.append([printed.label, *(words.number(off(responses, own), 3) for own in found)])
        best = found[int(np.argmin([off(responses, own) for own in found]))]
        for row, own in zip(responses.rows, best, strict=True):
            cells = [
                f"{row.measured[n]:g} / {words.number(own[n], 3)}" if n in row.measured else words.DASH for n in UNITS
            ]
            figures.append([f"{printed.label}, {row.label}", *cells])
    wanted = text["d7"]
    rows = Rows([wanted])
    return {
        "simulations": table(["simulated rows of", *(limit.label for limit in LIMITS)], errors),
        "simulated": table(
            ["printed / made again", "overshoot (%)", "settling (s)", "rise (s)", "error that stays (cm)"], figures
        ),
        "d7_any": words.number(fit_declared(rows, Model.parse("linear"), keep_start=False).rms, 3),
    }


def pictures(cases: Sequence[Case]) -> None:
    for case in [c for c in cases if c.name not in ("d9_half", "elevator")]:
        own = None
        if case.simulated is not None:
            own = {f.name: [row[f.name] for row in case.simulated] for f in case.responses.figures}
        names = [words.effect_words(step.effect) for step in case.judged.diagnosis.found.steps]
        title = f"{case.label}: {' and '.join(names) or 'nothing'} found"
        save(
            f"table_{case.name}",
            plot_rows(case.judged.diagnosis.to_json()["rows"], title, own, "simulated in the text"),
        )


def needed(cases: Sequence[Case]) -> str:
    """What dry friction alone, and what viscous friction alone, every table asks for."""
    rows = []
    for case in cases:
        dry, B = case.judged.asked[1].fit, case.viscous[0].fit
        assert dry is not None
        assert B is not None
        level = dry.model.number("coulomb_friction.level_pct")
        dry_Nm = level / TEXT[case.motor].torque_pct(1.0)
        rows.append([case.label, f"{level:.1f}", f"{dry_Nm:.4f}", f"{1e3 * B.constants[0][0]:.1f}"])
    return table(["table", "dry friction (%)", "(N m)", "larger B (0.001 N m s)"], rows)


def facts(data: Path, scratch: Path, cases: Sequence[Case]) -> dict[str, str]:
    """The numbers in the text."""
    by_name = {case.name: case for case in cases}
    up = by_name["d15_up"]
    overshoots = [row["overshoot_pct"] for row in up.figures("declared")]
    seen = [row.measured["overshoot_pct"] for row in up.responses.rows]
    arm = by_name["d9"]
    (response, *_) = arm.responses.responses
    ends = {}
    for stage in ("declared", "final"):
        found = arm.judged.diagnosis.found.declared if stage == "declared" else arm.judged.diagnosis.final
        ends[stage] = response.run(Plant.of(found.fit.model)).angle_deg[-1]
    one = by_name["elevator"]
    lifted = [by_name[name] for name in LIFTED]
    dry = [c.judged.asked[1].fit.model.number("coulomb_friction.level_pct") for c in lifted if c.judged.asked[1].fit]
    larger = [1e3 * c.viscous[0].fit.constants[0][0] for c in lifted if c.viscous[0].fit]
    return {
        "power_span": f"{seen[-1] - seen[0]:.1f}",
        "power_span_before": f"{overshoots[-1] - overshoots[0]:.1f}",
        "arm_end_before": f"{ends['declared']:.1f}",
        "arm_end_after": f"{ends['final']:.1f}",
        "count_overshoot": f"{100.0 / (5.0 * DEG_PER_CM):.2f}",
        "dry_span": f"{min(dry):.1f} to {max(dry):.1f}",
        "larger_span": f"{min(larger):.1f} to {max(larger):.1f}",
        "joint_steps": steps_table(one),
        "joint_walked": words.number(
            left_out_rms(one.judged.diagnosis.evidence, one.judged.diagnosis.final.fit, looks=SETTINGS.looks), 3
        ),
        "joint_before": words.number(one.before, 3),
        "joint_after": words.number(one.after, 3),
        "joint_falling": words.number(one.viscous[1].rms, 3),
        "joint_larger": words.number(one.viscous[0].rms, 3),
        "joint_backlash": words.number(one.judged.asked[0].rms, 3),
        "joint_dry": words.number(one.judged.asked[1].rms, 3),
    }


def section(folder: Path) -> dict[str, str]:
    """Judges every printed table, draws the pictures and gives the words of the section."""
    with tempfile.TemporaryDirectory() as scratch:
        cases = cases_of(folder, Path(scratch))
        pictures(cases)
        explained = [c.label for c in cases if c.judged.diagnosis.verdict == "explained"]
        return {
            "verdict": f"Explained to the floor: {words.listed(explained) if explained else 'no table'}.",
            "before_after": before_after(cases),
            "by_figure": by_figure(cases),
            "needed": needed([c for c in cases if c.name != "d9_half"]),
            **simulations(folder, Path(scratch)),
            **facts(folder, Path(scratch), cases),
            **steady_facts(folder, Path(scratch)),
        }
