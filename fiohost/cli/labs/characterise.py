"""``fiohost lab characterise``: readings of meters to a motor's constants."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fiohost.cli.labs.present import present, report_folder, result_options
from fiohost.cli.options import parse_number, parse_seed, target_option, wire_options
from fiohost.cli.output import output_for
from fiohost.cli.progress import progress
from fiohost.files import claim

if TYPE_CHECKING:
    from collections.abc import Callable

    from fiohost.labs.readings import Readings
    from fiohost.labs.result import LabResult


@click.command()
@click.option("--readings", "readings_from", metavar="F", help="Readings in TOML or CSV; without, virtual meters read.")
@target_option("sim:nxt_lego", "The board to read at.")
@click.option("--seed", metavar="N", help="How the shaft of a simulated board starts.")
@wire_options
@click.option(
    "--port", default="A", show_default=True, metavar="A|B", help="Motor port; rows of the other are left out."
)
@click.option("--inductance", metavar="H", help="Of the winding, by a meter; without, it is measured.")
@click.option("--supply", metavar="V", help="Armature voltage at full power, where readings do not say (4.5).")
@click.option("--save", "save_to", metavar="F", help="Write the constants for --constants of the other experiments.")
@click.option(
    "--diagnose/--no-diagnose",
    "name_it",
    default=True,
    show_default=True,
    help="At the end, name what a model without dry friction lacks beside the board.",
)
@result_options
def characterise(
    readings_from: str | None,
    target: str,
    seed: str | None,
    port: str,
    inductance: str | None,
    supply: str | None,
    save_to: str | None,
    name_it: bool,
    report: str | None,
    json_to: str | None,
) -> None:
    """Ra, Ki, Kb, B, dry friction, time constant and inertia with 95 % intervals, beside the text's values.

    \b
    Example:
      fiohost lab characterise --save motor.toml
      fiohost lab characterise --readings docs/labs/nxt_readings.toml --port A
    """
    from fiohost.labs.readings import Readings, check_port

    check_port(port, "--port")
    L_H = None if inductance is None else parse_number("--inductance", inductance, 0.0, 10.0, "H")
    full_V = None if supply is None else parse_number("--supply", supply, 0.1, 1000.0, "V")
    out, folder = output_for(json_to), report_folder(report)
    if save_to is not None:
        claim(save_to)

    from fiohost.labs.characterise import characterise as evaluate
    from fiohost.labs.solve_constants import constants_of, solve

    if readings_from is not None:
        readings = Readings.load(Path(readings_from), port)
        if full_V is not None:
            readings.supply_V = full_V
        result = evaluate(readings, L_H, readings_from)
    else:
        with progress() as doing:
            readings, result = _measured(target, seed, port, L_H, full_V, folder if name_it else None, doing)
        readings.write(folder / "readings.toml")
        out(f"readings: {folder / 'readings.toml'}")
    if save_to is not None:
        constants_of(solve(readings)[0], readings, L_H).write(Path(save_to))
        out(f"constants: {save_to}")
    present(result, out, folder)


def _measured(
    target: str,
    seed: str | None,
    port: str,
    L_H: float | None,
    full_V: float | None,
    folder: Path | None,
    doing: Callable[[str], None],
) -> tuple[Readings, LabResult]:
    """Readings by the virtual meters of a simulated board and what they give; with a folder, also what is missing."""
    from fiohost.bench.connect import connect
    from fiohost.labs.characterise import characterise as evaluate
    from fiohost.labs.characterise import viscous_only
    from fiohost.labs.constants import TEXT
    from fiohost.labs.difference import with_difference
    from fiohost.labs.measure import measure
    from fiohost.labs.play import target_volts
    from fiohost.labs.session import Session
    from fiohost.labs.small import with_small_steps

    with connect(target, seed=parse_seed(seed)) as bench:
        doing(f"meters at {target}: stalled, lifting, running free, running down")
        readings = measure(bench, port, L_H, full_V if full_V is not None else target_volts(bench, TEXT["no_load"]))
        result = evaluate(readings, L_H, target)
        if folder is not None:
            session = Session(viscous_only(readings, L_H), bench, folder, said=doing)
            result, model, limited = with_small_steps(session, result)
    if folder is not None:
        result = with_difference(result, model, doing, limited=limited)
    return readings, result
