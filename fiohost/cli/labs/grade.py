"""``fiohost lab grade``: what was handed in, against the seals."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import click

from fiohost.cli.options import PATH, parse_number
from fiohost.cli.output import json_option, output_for
from fiohost.cli.progress import progress
from fiohost.files import claim, write_output


@click.command()
@click.argument("folder", type=PATH)
@click.option(
    "--tolerance", default="10", show_default=True, metavar="PCT", help="Error up to which a parameter is right."
)
@click.option("-o", "--output", type=PATH, metavar="TABLE.csv", help="Write the table as CSV too.")
@json_option
def grade(folder: Path, tolerance: str, output: Path | None, json_to: str | None) -> None:
    """For teachers: compare the models in FOLDER with the sealed benches of the students that they are named after.

    Every student drives a bench of their own (--student ID), finds its model, and hands it in as ID.toml, made by
    identify or diagnose with --save-model. The table says what each bench had, what was named, how far the parameters
    are off, and how far the model is from a fresh record of the bench; it is for you alone.

    \b
    Example:
      fiohost run staircase --student anna --log anna.csv
      fiohost identify anna.csv --from duty --save-model handed_in/anna.toml
      fiohost lab grade handed_in -o grades.csv
    """
    say = output_for(json_to)
    allowed = parse_number("--tolerance", tolerance, 0.01, 1000.0, "percent")
    if output is not None:
        claim(output)
    from fiohost.labs.grade import grade_folder

    with progress() as doing:
        grades = grade_folder(folder, doing)
    head = ("student", "effects of the bench", "named", "right", f"parameters within {allowed:g} %", "fresh record",
            "largest error")  # fmt: skip
    rows = []
    for one in grades:
        errors = one.errors_pct or {}
        worst = max(errors, key=lambda key: abs(errors[key]), default="")
        rows.append(
            (
                one.student,
                ", ".join(one.true_effects) or "none",
                ", ".join(one.named) or ("-" if one.problem else "none"),
                "yes" if one.effects_right else "no",
                f"{one.within(allowed)} of {len(errors)}",
                "" if one.fresh_rms_deg is None else f"{one.fresh_rms_deg:.3g} deg rms",
                one.problem or (f"{worst} {errors[worst]:+.1f} %" if worst else ""),
            )
        )
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head) - 1)]
    for row in (head, *rows):
        say("  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[-1]]).rstrip())
    right = sum(one.effects_right for one in grades)
    say(f"{len(grades)} handed in; effects right: {right}")
    if output is not None:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([_as_text(cell) for cell in row] for row in (head, *rows))
        write_output(output, text.getvalue())
        say(f"table: {output}")
    say.json({"schema": "fiohost.grades/1", "tolerance_pct": allowed, "grades": [g.to_json(allowed) for g in grades]})


def _as_text(cell: str) -> str:
    """A cell that no spreadsheet takes for a formula, whatever a student has named a file or an effect."""
    return f"'{cell}" if cell.startswith(("=", "+", "-", "@", "\t", "\r")) else cell
