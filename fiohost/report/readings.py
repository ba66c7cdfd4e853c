"""A diagnosis of tables of readings: on the terminal, and as pictures of every figure row by row.

Knows the JSON of the diagnosis and nothing else.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from fiohost.report.series import CurvePlot
from fiohost.report.tables import FILE_WIDTH, VERDICT_STYLE, candidate_table, new_table, parameter_table
from fiohost.report.words import error_of, found_words, listed, number

FIGURES = {
    "overshoot_pct": "overshoot",
    "rise_s": "rise time",
    "peak_s": "peak time",
    "settling_2_s": "settling time (2 %)",
    "settling_5_s": "settling time (5 %)",
    "final": "final value",
    "steady_state_error": "steady-state error",
}


def figure_words(name: str) -> str:
    return FIGURES.get(name, name.replace("_", " "))


def readings_sentence(diagnosis: Mapping[str, Any]) -> str:
    """The result in one or two sentences that stand alone; errors are in floors, what rounding and scatter leave."""
    verdict = diagnosis.get("verdict")
    declared = str((diagnosis.get("declared") or {}).get("model", "the declared model"))
    if verdict == "cannot_be_judged":
        return f"Cannot be judged: {diagnosis.get('why')}."
    found = found_words(diagnosis)
    before, after = (number(error_of(diagnosis.get(k), "train"), 3) for k in ("before", "after"))
    limit = number(error_of(diagnosis.get("floor"), "train", "limit_rms"), 3)
    level = f"chance leaves up to {limit} times the floor"
    if verdict == "no_missing_effect":
        return f"Nothing is missing: {declared} leaves {after} times the floor of these readings; {level}."
    change = f"The error falls from {before} to {after} times the floor; {level}."
    if verdict == "explained":
        return f"Missing from {declared}: {listed(found)}. {change}"
    names = [figure_words(str(n)) for n in (diagnosis.get("residual") or {}).get("depends_on") or []]
    remains = f"what remains is in {listed(names)}" if names else "what remains is spread over all figures"
    if found:
        return f"Partly explained: adding {listed(found)} helped, but more remains. {change} Unexplained: {remains}."
    return (
        f"Unexplained: {declared} leaves {after} times the floor and no candidate accounts for it; {level}; {remains}."
    )


def print_readings(console: Console, diagnosis: Mapping[str, Any]) -> None:
    """Print one diagnosis of readings: verdict first, then the figures behind it."""
    style = VERDICT_STYLE.get(str(diagnosis.get("verdict")), "bold yellow")
    console.print(Text(readings_sentence(diagnosis), style=style))
    console.print()
    tables = [error_table(diagnosis), row_table(diagnosis), parameter_table(diagnosis)]
    if diagnosis.get("candidates"):
        tables.append(candidate_table(diagnosis))
    width = console.width
    if not console.is_terminal:
        console.width = max(width, FILE_WIDTH)
    for table in tables:
        console.print(table)
        console.print()
    console.width = width
    console.print(Text(f"took {number(diagnosis.get('seconds'), 3)} s", style="dim"))


def error_table(diagnosis: Mapping[str, Any]) -> Table:
    """Errors in floors: of the fit, on rows left out, and the share of figures that no rounding gives."""
    table = new_table("Error in times the floor, rms")
    table.add_column("model", no_wrap=True)
    for heading in ("fitted rows", "rows left out", "beyond rounding"):
        table.add_column(heading, justify="right")
    stages = [(str((diagnosis.get("declared") or {}).get("model", "declared")), diagnosis.get("before"))]
    stages += [(f"+ {step.get('effect')}", step.get("after")) for step in diagnosis.get("steps") or []]
    for name, block in stages:
        outside = number(error_of(block, "train", "bin_violation_pct"), 3)
        cells = [number(error_of(block, "train", key), 3) for key in ("free_run_rms", "left_out_rms")]
        table.add_row(Text(name), *cells, f"{outside} %")
    table.add_section()
    floor = diagnosis.get("floor")
    text = number(error_of(floor, "train"), 3)
    table.add_row("floor (from replicas)", text, "", "", style="dim")
    table.add_row("what chance may leave", number(error_of(floor, "train", "limit_rms"), 3), "", "", style="dim")
    return table


def row_table(diagnosis: Mapping[str, Any]) -> Table:
    """Every row: each figure as measured, by the declared and by the final model."""
    rows = diagnosis.get("rows") or []
    names = list(dict.fromkeys(name for row in rows for name in row["figures"]))
    units = {name: row["figures"][name]["unit"] for row in rows for name in row["figures"]}
    steps = bool(diagnosis.get("steps"))
    table = new_table("Readings: measured, declared" + (", final" if steps else ""))
    several = len({row["readings"] for row in rows}) > 1
    table.add_column("row", no_wrap=True)
    for name in names:
        unit = f" ({units[name]})" if units[name] else ""
        table.add_column(f"{figure_words(name)}{unit}", justify="right")
    for row in rows:
        cells = []
        for name in names:
            figure = row["figures"].get(name)
            keys = ("measured", "before", "after") if steps else ("measured", "before")
            cells.append("  ".join(number(figure[key], 3) for key in keys) if figure else "")
        table.add_row(Text(f"{row['readings']}: {row['row']}" if several else str(row["row"])), *cells)
    return table


def readings_curves(diagnosis: Mapping[str, Any]) -> list[CurvePlot]:
    """One picture a figure and table: measured points with the floor, declared and final over the rows."""
    found = []
    rows = diagnosis.get("rows") or []
    for table in dict.fromkeys(row["readings"] for row in rows):
        own = [row for row in rows if row["readings"] == table]
        for name in dict.fromkeys(name for row in own for name in row["figures"]):
            having = [row for row in own if name in row["figures"]]
            found.append(_curve(str(table), name, having, bool(diagnosis.get("steps"))))
    return found


def _curve(table: str, name: str, rows: Sequence[Mapping[str, Any]], steps: bool) -> CurvePlot:
    figures = [row["figures"][name] for row in rows]
    x = np.arange(1.0, len(rows) + 1.0)
    measured = np.array([f["measured"] for f in figures])
    floor = np.array([f["floor"] for f in figures])
    unit = f" ({figures[0]['unit']})" if figures[0]["unit"] else ""
    lines = {"declared": np.array([f["before"] for f in figures])}
    if steps:
        lines = {"final": np.array([f["after"] for f in figures]), **lines}
    labels = [str(row["row"]) for row in rows]
    return CurvePlot(
        title=f"{table}, {figure_words(name)}",
        x_label=f"row: {'; '.join(labels)}" if len("; ".join(labels)) < 90 else "row",
        y_label=f"{figure_words(name)}{unit}",
        x=x,
        lines=lines,
        band=(measured - 2.0 * floor, measured + 2.0 * floor),
        band_label="measured, two floors to either side",
        points={"measured": (x, measured)},
    )
