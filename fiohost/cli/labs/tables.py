"""``fiohost lab tables``: a table of measurements round the circle."""

from __future__ import annotations

from pathlib import Path

import click

from fiohost.cli.labs.present import present, report_folder, result_options
from fiohost.cli.options import PATH, parse_seed
from fiohost.cli.output import output_for
from fiohost.cli.progress import progress


@click.command()
@click.option(
    "--readings", multiple=True, required=True, type=PATH, metavar="FILE",
    help="A readings file, fiohost.readings/1; repeated files are judged together.",
)  # fmt: skip
@click.option(
    "--model", default="linear", show_default=True, metavar="M", help="Declared: linear+EFFECT+... or a file."
)
@click.option("--explain", multiple=True, metavar="EFFECT", help="Fit this effect too and say what it is worth.")
@click.option("--seed", default="0", show_default=True, metavar="N", help="Seed of the replicas that make the floor.")
@result_options
def tables(
    readings: tuple[Path, ...], model: str, explain: tuple[str, ...], seed: str, report: str | None, json_to: str | None
) -> None:
    """Close the circle on a table of figures: error before, missing effect, error after and on rows left out.

    \b
    Example:
      fiohost lab tables --readings responses.toml --model linear
      fiohost lab tables --readings responses.toml --model motor.toml --explain backlash
    """
    drawn = parse_seed(seed) or 0
    out, folder = output_for(json_to), report_folder(report)

    from fiohost.labs.tables import tables as run

    with progress() as doing:
        result = run(readings, model, explain, seed=drawn, say=doing)
    present(result, out, folder)
