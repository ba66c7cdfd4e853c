"""``fiohost lab problems``: the text's problems D-1 to D-19."""

from __future__ import annotations

import click

from fiohost.cli.labs.present import present, report_folder, result_options, show
from fiohost.cli.options import parse_number
from fiohost.cli.output import output_for
from fiohost.cli.progress import progress
from fiohost.errors import ConfigError


@click.command()
@click.argument("problem", required=False, metavar="[D-N]")
@click.option("--set", "changes", multiple=True, metavar="KEY=VALUE", help="Ask it with another number; repeated.")
@click.option("--list", "listing", is_flag=True, help="List the problems and the numbers in each.")
@result_options
def problems(
    problem: str | None, changes: tuple[str, ...], listing: bool, report: str | None, json_to: str | None
) -> None:
    """Answer the problems D-1 to D-19 of the control lab appendix by computation, or one of them with other numbers.

    \b
    Example:
      fiohost lab problems
      fiohost lab problems D-7 --set kp=0.2 --set load_Nm=0
      fiohost lab problems --list
    """
    if changes and problem is None:
        raise click.UsageError("--set goes with one problem: name it, as in D-7")
    out = output_for(json_to)

    from fiohost.labs.problems.catalogue import PROBLEMS
    from fiohost.labs.problems.catalogue import problem as by_name

    if listing:
        chosen = PROBLEMS.values() if problem is None else [by_name(problem)]
        for item in chosen:
            numbers = ", ".join(f"{key}={value:g}" for key, value in item.numbers.items())
            out(f"D-{item.number:<3d} {item.about}\n      {numbers}")
        out.json([{"problem": f"D-{p.number}", "about": p.about, "numbers": dict(p.numbers)} for p in chosen])
        return
    if problem is not None:
        asked = by_name(problem)
        folder = report_folder(report)
        present(asked.solve(dict(map(_change, changes))), out, folder)
        return
    folder = report_folder(report)
    found = []
    for item in PROBLEMS.values():
        with progress() as doing:
            doing(f"problem D-{item.number}: {item.about}")
            solved = item.solve()
        found.append(show(solved, out, folder))
        out()
    out.json(found)


def _change(text: str) -> tuple[str, float]:
    """``KEY=VALUE``. Raises ConfigError."""
    key, equals, value = text.partition("=")
    if not equals:
        raise ConfigError(f"--set {text[:60]!r} is not KEY=VALUE")
    return key.strip(), parse_number(f"--set {key.strip()}", value, -1e9, 1e9)
