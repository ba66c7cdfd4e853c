"""``fiohost lab design``: a controller to a specification, simulated and run."""

from __future__ import annotations

import click

from fiohost.cli.labs.present import present, report_folder, result_options
from fiohost.cli.options import parse_number, parse_seed, profile_option, target_options
from fiohost.cli.output import output_for
from fiohost.cli.progress import progress


@click.command()
@target_options
@profile_option
@click.option("--model", metavar="M", help="Model to design on.  [default: identified first, with friction]")
@click.option("--controller", default="pd", show_default=True, metavar="p|pd|pi|pid", help="Kind of controller.")
@click.option("--overshoot", default="5", show_default=True, metavar="PCT", help="Largest overshoot.")
@click.option("--settling", default="0.5", show_default=True, metavar="S", help="Longest settling time.")
@click.option("--sse", default="1", show_default=True, metavar="DEG", help="Largest steady-state error.")
@result_options
def design(
    target: str, seed: str | None, profile: str | None, model: str | None, controller: str, overshoot: str,
    settling: str, sse: str, report: str | None, json_to: str | None,
) -> None:  # fmt: skip
    """Design a controller in simulation, then run it on squares of 170/190, 135/225 and 90/270 deg: both in one table
    and one picture each.

    \b
    Examples:
      fiohost lab design
      fiohost lab design --profile bench.toml --model motor.toml --controller pid
    """
    out = output_for(json_to)
    folder = report_folder(report)
    numbers = (
        parse_number("--overshoot", overshoot, 0.001, 500.0, "percent"),
        parse_number("--settling", settling, 0.001, 60.0, "s"),
        parse_number("--sse", sse, 0.001, 360.0, "deg"),
    )

    from fiohost.bench.connect import connect
    from fiohost.bench.profile import BenchProfile
    from fiohost.control.specification import Specification
    from fiohost.labs.design import design_lab
    from fiohost.motor.model import Model

    known = None if profile is None else BenchProfile.load(profile)
    motor = None if model is None else Model.parse(model)
    with progress() as doing, connect(target, seed=parse_seed(seed)) as bench:
        doing(f"a design on the model, then three squares on the target, on {target}")
        result = design_lab(bench, folder, Specification(*numbers), controller, known, motor)
    present(result, out, folder)
