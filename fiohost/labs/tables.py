"""Tables of readings taken round the circle: the model's error before, the effect found, the error after and left out.

The same as ``fiohost diagnose --readings`` finds, shown row by row in one picture a table, with what else one may have
been told to believe fitted and judged beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fiohost.circle.readings import diagnose_readings
from fiohost.discover.tables.diagnose import TableDiagnosis
from fiohost.discover.tables.worth import Worth, scatter_needed, worth
from fiohost.labs.result import Answer, Cell, LabResult, Table
from fiohost.motor.model import Model
from fiohost.report.readings import figure_words, readings_sentence
from fiohost.report.words import effect_words, listed, number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fiohost.report.panels import Panel

Rows = Sequence[Mapping[str, Any]]  # the rows of a diagnosis of tables


@dataclass(frozen=True)
class Judged:
    """A diagnosis of tables and what the explanations asked for are worth beside the declared model."""

    diagnosis: TableDiagnosis
    asked: tuple[Worth, ...] = ()

    def scatter(self, stage: str) -> dict[str, float]:
        """What scatter every figure would need for the ``declared`` or ``final`` model to pass, in its own unit."""
        found = self.diagnosis.final if stage == "final" else self.diagnosis.found.declared
        needed = scatter_needed(found.fit.rms, found.limit_rms)
        return {f.name: needed * f.floor for table in self.diagnosis.evidence.rows.tables for f in table.figures}


def judge(found: TableDiagnosis, explain: Sequence[str] = ()) -> Judged:
    """Fit each asked effect beside the declared model of a diagnosis. Raises FiohostError."""
    return Judged(found, tuple(worth(found.evidence, found.root, name) for name in explain))


def tables(
    paths: Sequence[str | Path],
    model: str | Model,
    explain: Sequence[str] = (),
    *,
    seed: int = 0,
    say: Callable[[str], None] = lambda text: None,
) -> LabResult:
    """The whole lab on a user's readings files. Raises FiohostError."""
    judged = judge(diagnose_readings(paths, model, seed=seed, say=say), explain)
    told = judged.diagnosis.to_json()
    names = [table.name for table in judged.diagnosis.evidence.rows.tables]
    return LabResult(
        name="tables",
        title="Tables of readings: before, after, left out",
        target=", ".join(names),
        tables=(error_table(judged), scatter_table(judged), *(row_table(told, name) for name in names)),
        answers=(
            Answer("What does the declared model lack?", readings_sentence(told)),
            *(Answer(f"What is {effect_words(w.name)} worth?", worth_text(judged, w)) for w in judged.asked),
        ),
        values={"diagnosis": told, "asked": [worth_json(w) for w in judged.asked]},
        figures={
            f"tables_{name}": partial(plot_rows, [r for r in told["rows"] if r["readings"] == name], name)
            for name in names
        },
    )


def error_table(judged: Judged) -> Table:
    """Errors of all models, in floors; what was asked for stands beside the declared model."""
    search = judged.diagnosis.found
    rows: list[list[Cell]] = [_stage_row(search.declared.fit.model.expression, search.declared)]
    rows += [_stage_row(f"+ {step.effect}", step.stage) for step in search.steps]
    rows += [[f"declared + {w.name}", w.rms, w.left_out_rms, None] for w in judged.asked]
    head = ("model", "all rows", "rows left out in turn", "chance may leave")
    return Table("Error in times the floor, rms", head, rows)


def _stage_row(label: str, stage: Any) -> list[Cell]:
    return [label, stage.fit.rms, stage.left_out_rms, stage.limit_rms]


def scatter_table(judged: Judged) -> Table:
    """How much the readings would have to scatter for the declared and for the final model to be good enough."""
    before, after = judged.scatter("declared"), judged.scatter("final")
    figures = {f.name: f for table in judged.diagnosis.evidence.rows.tables for f in table.figures}
    rows: list[list[Cell]] = [
        [figure_words(n), f.unit, f.floor, before[n], after[n]] for n, f in sorted(figures.items())
    ]
    head = ("figure", "unit", "floor", "declared would pass at", "final would pass at")
    return Table("Standard deviation that the readings would need", head, rows)


def row_table(told: Mapping[str, Any], name: str) -> Table:
    """Every reading of one table beside the declared and the final model."""
    rows: list[list[Cell]] = []
    for row in [r for r in told["rows"] if r["readings"] == name]:
        for figure, f in row["figures"].items():
            label = f"{figure_words(figure)} ({f['unit']})" if f["unit"] else figure_words(figure)
            rows.append([str(row["row"]), label, f["measured"], f["before"], f["after"]])
    return Table(f"Readings of {name}", ("row", "figure", "measured", "before", "after"), rows, given=(0, 1, 2))


def worth_text(judged: Judged, w: Worth) -> str:
    """One sentence on an explanation that was asked for."""
    declared = judged.diagnosis.found.declared
    if w.fit is None:
        return f"Nothing: it {w.why_not}."
    sizes = [f"{q} = {number(v, 3)}" if not isinstance(v, str) else f"{q} = {v}" for q, v in _sizes(w)]
    text = f"With {listed(sizes)} it takes the error from {number(declared.fit.rms, 3)} to {number(w.rms, 3)} floors"
    if w.left_out_rms is not None:
        text += f", {number(w.left_out_rms, 3)} on rows left out"
    return f"{text}; it is not believed, as it {w.why_not}." if w.why_not else f"{text}."


def _sizes(w: Worth) -> list[tuple[str, Any]]:
    values = w.fit.model.values if w.fit is not None else {}
    return [(key.partition(".")[2], value) for key, value in values.items() if key.startswith(f"{w.name}.")]


def worth_json(w: Worth) -> dict[str, Any]:
    return {
        "effect": w.name,
        "rms": w.rms,
        "left_out_rms": w.left_out_rms,
        "parameters": dict(_sizes(w)),
        "not_believed_because": w.why_not,
    }


def plot_rows(
    rows: Rows, title: str, theirs: Mapping[str, Sequence[float]] | None = None, label: str = "theirs"
) -> Figure:
    """One table in a picture, a panel a figure: measured, before and after over the rows.

    ``theirs`` are figures of somebody else's model, one a row, by name.
    """
    from fiohost.report.panels import Curve, Panel, plot_panels

    x, x_label = _places([str(row["row"]) for row in rows])
    panels: list[Panel] = []
    for name in dict.fromkeys(n for row in rows for n in row["figures"]):
        here = [i for i, row in enumerate(rows) if name in row["figures"]]
        figures = [rows[i]["figures"][name] for i in here]
        at = x[here]
        curves = [
            Curve(at, [f["before"] for f in figures], "before", 1, "model"),
            Curve(at, [f["after"] for f in figures], "after", 0, "plain"),
            Curve(at, [f["measured"] for f in figures], "measured", -2, "points"),
        ]
        if theirs and name in theirs:
            curves.append(Curve(x, theirs[name], label, 2, "crosses"))
        if panels:  # one legend is enough
            curves = [Curve(c.x, c.y, "", c.case, c.style) for c in curves]
        unit = f" ({figures[0]['unit']})" if figures[0]["unit"] else ""
        panels.append(Panel(curves, f"{figure_words(name)}{unit}", x_label))
    return plot_panels(panels, title, columns=2 if len(panels) > 1 else 1, panel_height=2.6)


def _places(labels: Sequence[str]) -> tuple[np.ndarray, str]:
    """Where rows stand on the x axis: at the number that tells them apart, else at their place in the table."""
    parts = [dict(pair.rpartition(" ")[::2] for pair in label.split(", ")) for label in labels]
    changing = [n for n in parts[0] if len({p.get(n) for p in parts}) > 1]
    try:
        if len(changing) == 1:
            return np.array([float(p[changing[0]]) for p in parts]), changing[0]
    except (KeyError, ValueError):
        pass
    return np.arange(1.0, len(labels) + 1.0), "row"
