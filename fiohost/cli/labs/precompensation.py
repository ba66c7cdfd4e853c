"""``fiohost lab precompensation``: how much of the deadband may be compensated."""

from __future__ import annotations

from pathlib import Path

import click

from fiohost.cli.labs.present import present, report_folder, result_options
from fiohost.cli.options import parse_seed, profile_option, target_options
from fiohost.cli.output import output_for
from fiohost.cli.progress import progress
from fiohost.files import claim


@click.command()
@target_options
@profile_option
@click.option("--controller", metavar="FILE", help="Controller file.  [default: P with kp = 1, the text's C(s) = 1]")
@click.option("--save", "save_to", metavar="FILE", help="Write the bench profile with the share that was found.")
@result_options
def precompensation(
    target: str, seed: str | None, profile: str | None, controller: str | None, save_to: str | None, report: str | None,
    json_to: str | None,
) -> None:  # fmt: skip
    """Add shares of the deadband to a controller's output (Eq. 2.6 of the INC451 lab text), see where the loop jitters,
    and reduce them until it does not.

    \b
    Examples:
      fiohost lab precompensation --save bench.toml
      fiohost lab precompensation --profile bench.toml --controller pd.toml
    """
    out = output_for(json_to)
    folder = report_folder(report)
    if save_to is not None:
        claim(save_to)

    from fiohost.bench.connect import connect
    from fiohost.bench.profile import BenchProfile
    from fiohost.control.settings import ControlSettings
    from fiohost.labs.precompensation import precompensation as run

    known = None if profile is None else BenchProfile.load(profile)
    law = None if controller is None else ControlSettings.load(Path(controller))
    with progress() as doing, connect(target, seed=parse_seed(seed)) as bench:
        doing(f"one loop for each share of the deadband, on {target}")
        result, kept = run(bench, folder, known, law)
    if save_to is not None:
        kept.save(save_to)
    present(result, out, folder)
    if save_to is not None:
        out(f"bench profile: {save_to}")
