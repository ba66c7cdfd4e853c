"""``fiohost lab identification``: K and tau from a closed loop, two ways."""

from __future__ import annotations

import click

from fiohost.cli.labs.present import present, report_folder, result_options
from fiohost.cli.options import parse_seed, profile_option, target_options
from fiohost.cli.output import output_for
from fiohost.cli.progress import progress


@click.command()
@target_options
@profile_option
@result_options
def identification(target: str, seed: str | None, profile: str | None, report: str | None, json_to: str | None) -> None:
    """Run a square wave of 170/190 deg, period 6 s, with C(s) = 1, and find K and tau by the steps' figures and by a
    fit of the second-order form; then say why they differ.

    \b
    Examples:
      fiohost lab identification
      fiohost lab identification --profile bench.toml --report lab
    """
    out = output_for(json_to)
    folder = report_folder(report)

    from fiohost.bench.connect import connect
    from fiohost.bench.profile import BenchProfile
    from fiohost.labs.identification import identification as run

    known = None if profile is None else BenchProfile.load(profile)
    with progress() as doing, connect(target, seed=parse_seed(seed)) as bench:
        doing(f"the square wave, then both methods and a fit with friction, on {target}")
        result = run(bench, folder, known)
    present(result, out, folder)
