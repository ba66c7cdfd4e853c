"""A diagnosis on the terminal: the verdict in plain words, errors against the floor, parameters, candidates.

Everything printed comes out of the diagnosis' JSON; text from files is never read as markup.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from fiohost.report.outlook import print_outlook
from fiohost.report.preliminary import print_preliminary
from fiohost.report.words import (
    ROLE_WORDS,
    error_of,
    interval,
    listed,
    number,
    own_start_sentence,
    remark,
    rivals_of,
    roles_of,
    share,
    verdict_sentence,
)

CANDIDATES_SHOWN = 8
FILE_WIDTH = 132  # columns where the text goes to a file or pipe, which has no edge
VERDICT_STYLE = {"no_missing_effect": "bold green", "explained": "bold green", "unexplained": "bold yellow"}


def print_diagnosis(console: Console, diagnosis: Mapping[str, Any], verbose: bool = False) -> None:
    """Print one diagnosis (schema ``fiohost.diagnosis/1``): verdict first, then the figures behind it."""
    console.print(Text(verdict_sentence(diagnosis), style=VERDICT_STYLE.get(str(diagnosis.get("verdict")), "bold")))
    console.print()
    print_preliminary(console, diagnosis, verbose)
    tables = [error_table(diagnosis), parameter_table(diagnosis)]
    if diagnosis.get("logs"):
        tables.insert(1, log_table(diagnosis))
    if diagnosis.get("candidates"):
        tables.append(candidate_table(diagnosis))
    width = console.width
    if not console.is_terminal:
        console.width = max(width, FILE_WIDTH)
    for table in tables:
        console.print(table)
        console.print()
    if diagnosis.get("explained_to") != "sensor" and (own := own_start_sentence(diagnosis)):
        console.print(Text(own))
        console.print()
    print_outlook(console, diagnosis)
    console.width = width
    seconds = diagnosis.get("seconds")
    if seconds is not None:
        console.print(Text(f"took {number(seconds, 3)} s", style="dim"))


def error_table(diagnosis: Mapping[str, Any]) -> Table:
    """Errors before, after each effect and at the end, beside the floor, for both roles."""
    unit = str(diagnosis.get("output_unit", ""))
    table = new_table(f"Error in {unit} rms" if unit else "Error rms")
    table.add_column("model", no_wrap=True)
    roles = roles_of(diagnosis)
    for role in (ROLE_WORDS[r] for r in roles):
        table.add_column(f"{role}\nwhole run", justify="right")
        table.add_column(f"{role}\n1 s windows", justify="right")
    table.add_column("outside the\nencoder bin", justify="right")
    declared = str((diagnosis.get("declared") or {}).get("model", "declared"))
    table.add_row(declared, *_error_cells(diagnosis.get("before"), roles))
    for step in diagnosis.get("steps") or []:
        table.add_row(Text(f"+ {step.get('effect')}"), *_error_cells(step.get("after"), roles))
    table.add_section()
    source = (diagnosis.get("floor") or {}).get("from")
    label = f"floor (from {source})" if source else "floor"
    table.add_row(Text(label), *_error_cells(diagnosis.get("floor"), roles), style="dim")
    return table


def log_table(diagnosis: Mapping[str, Any]) -> Table:
    """One row a log: its role, error before and after, and its own floor."""
    table = new_table("Logs (whole run, rms)")
    for name in ("log", "role"):
        table.add_column(name, no_wrap=True)
    for name in ("before", "after", "floor", "after / floor", "fit %"):
        table.add_column(name, justify="right")
    for log in diagnosis["logs"]:
        after, floor = error_of(log, "after"), error_of(log, "floor")
        ratio = after / floor if after is not None and floor else None
        table.add_row(
            Text(Path(str(log.get("file", "?"))).name),
            "held out" if log.get("role") == "holdout" else "training",
            number(error_of(log, "before"), 3),
            number(after, 3),
            number(floor, 3),
            number(ratio, 3),
            number(error_of(log, "after", "fit_pct")),
        )
    return table


def parameter_table(diagnosis: Mapping[str, Any]) -> Table:
    """Parameters of the final model with their 95 % intervals."""
    final = diagnosis.get("final") or diagnosis.get("declared") or {}
    table = new_table(f"Parameters of {final.get('model', 'the model')}")
    table.add_column("parameter", no_wrap=True)
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("95 % interval", justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("remark")
    for name, parameter in (final.get("parameters") or {}).items():
        table.add_row(
            Text(str(name)),
            number(parameter.get("value"), 5),
            interval(parameter),
            Text(str(parameter.get("unit", ""))),
            Text(remark(parameter), style="yellow"),
        )
    return table


def candidate_table(diagnosis: Mapping[str, Any]) -> Table:
    """The best-scored candidates and why they were or were not taken."""
    steps = diagnosis.get("steps") or []
    chosen = {str(step.get("effect")): step for step in steps}
    ranked = sorted(diagnosis["candidates"], key=lambda c: -float(c.get("score") or 0.0))
    rest = len(ranked) - CANDIDATES_SHOWN
    table = new_table("Candidates" + (f" (best {CANDIDATES_SHOWN} of {len(ranked)})" if rest > 0 else ""))
    table.add_column("effect", no_wrap=True)
    table.add_column("score", justify="right", no_wrap=True)
    table.add_column("outcome")
    for candidate in ranked[:CANDIDATES_SHOWN]:
        name = str(candidate.get("effect"))
        reason = str(candidate.get("rejected_because") or "")
        if name in chosen:
            rivals = rivals_of(diagnosis, chosen[name])
            reason = "chosen" + (f"; these data cannot tell it from {listed(rivals, 'or')}" if rivals else "")
        table.add_row(Text(name), share(candidate.get("score")), Text(reason))
    return table


def _error_cells(block: Any, roles: Sequence[str]) -> list[str]:
    cells = [number(error_of(block, role, key), 3) for role in roles for key in ("free_run_rms", "window_rms")]
    outside = error_of(block, "holdout", "bin_violation_pct")
    outside = error_of(block, "train", "bin_violation_pct") if outside is None else outside
    text = number(outside, 3)
    return [*cells, text if outside is None else f"{text} %"]


def new_table(title: str) -> Table:
    return Table(title=Text(title, style="bold"), title_justify="left", box=None, pad_edge=False, header_style="dim")
