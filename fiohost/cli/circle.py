"""The whole circle as one command: ``close-loop``."""

from __future__ import annotations

from pathlib import Path

import click

from fiohost.cli.options import PATH, parse_seed, wire_options
from fiohost.cli.output import json_option, output_for
from fiohost.cli.progress import progress
from fiohost.files import report_folder


@click.command("close-loop")
@click.option("--target", default="sim:sealed", show_default=True, metavar="T", help="Board to run on.")
@wire_options
@click.option("--seed", metavar="N", help="Draw the sealed board by this seed; at random without.")
@click.option("--model", default="linear+coulomb_friction", show_default=True, metavar="M", help="Declared model.")
@click.option(
    "--report",
    type=PATH,
    metavar="DIR",
    help="Folder of logs, page and plots. [default: close-loop, or close-loop-N]",
)
@click.option(
    "--constants",
    metavar="SET|FILE",
    help="The motor's constants, as of lab characterise --save: the report says V, A and N m too.",
)
@click.option("--no-follow-up", is_flag=True, help="Never run one more experiment to tell rivals apart.")
@json_option
def close_loop(
    target: str, seed: str | None, model: str, report: Path | None, constants: str | None, no_follow_up: bool,
    json_to: str | None,
) -> None:  # fmt: skip
    """Run a suite of experiments, name what the model lacks, and prove it on a fresh record.

    Where the data cannot tell effects apart and an experiment of the menu would, that one is run too, and all is
    diagnosed once more.

    On a sealed board the plant and its undeclared effects (none, one or two) are drawn at random and shown only at the
    very end.

    \b
    Examples:
      fiohost close-loop
      fiohost close-loop --seed 7 --report out
    """
    from fiohost.bench.connect import connect
    from fiohost.bench.seal import is_sealed
    from fiohost.circle.close import close_loop as run_circle
    from fiohost.discover.result import to_json
    from fiohost.labs.constants import MotorConstants
    from fiohost.motor.model import Model
    from fiohost.report.circle import confirm_series, follow_up_sentence, print_circle
    from fiohost.report.diagnosis import curves_of, series_of
    from fiohost.report.page import write_page
    from fiohost.report.physical import constants_of
    from fiohost.report.plots import save_plots

    say = output_for(json_to)
    declared, drawn = Model.parse(model), parse_seed(seed)
    motor = MotorConstants.load(constants) if constants else None
    folder = report_folder(report or Path("close-loop"), chosen=report is not None)
    with connect(target, seed=drawn) as bench, progress() as doing:
        circle = run_circle(bench, folder, declared, follow_up=not no_follow_up, say=doing)
    known = constants_of([circle.fresh_log.metadata], motor)
    diagnosis = {**to_json(circle.diagnosis), "constants": known.to_json()}
    seal = _open_seal(circle.fresh_log.path, target) if is_sealed(target) else None
    result = circle.to_json(diagnosis, seal)
    print_circle(say.console, result, say.verbose)
    circle.diagnosis.final.fit.model.write(folder / "model.toml", "fitted by fiohost close-loop")
    say.json(result)  # before the pictures, so that a full disk does not cost the result
    series = [confirm_series(circle), *series_of(circle.diagnosis)]
    save_plots(folder, series, diagnosis, curves_of(circle.diagnosis))
    page = folder / "report.html"
    write_page(
        page, title="The closed circle", diagnosis=diagnosis, series=series, seal=seal,
        confirm=circle.confirmation.to_json(), curves=curves_of(circle.diagnosis),
        follow_up=follow_up_sentence(result["follow_up"]) if circle.follow_up else "",
    )  # fmt: skip
    say(f"page: {page}")


def _open_seal(log: Path, target: str) -> dict[str, object]:
    """The truth about a sealed board, from its log: the last thing that is done."""
    from fiohost.bench.seal import find_seed, find_version, is_faulty
    from fiohost.transport.instruments import break_seal

    return break_seal(find_seed(str(log)), find_version(str(log)), faulty=is_faulty(target))
