"""Commands about data and the library: ``import`` and ``effects``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fiohost.cli.output import check_writable, json_option, output_for

if TYPE_CHECKING:
    from fiohost.cli.output import Output
    from fiohost.motor.effect import Effect, Parameter


@click.command("import")
@click.argument("table", type=click.Path(path_type=Path))
@click.option("--map", "map_name", required=True, metavar="MAP", help="Map file, or the name of a shipped one.")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="LOG", help="Log to write.")
@json_option
def import_(table: Path, map_name: str, output: Path, json_to: str | None) -> None:
    """Make a log of any table of numbers (CSV, TSV) with a MAP that names its columns and units.

    \b
    Example:
      fiohost import power_040.csv --map nxt_open_loop -o log_040.csv
    """
    from fiohost.bench.imports import TableMap, import_table

    say = output_for(json_to)
    check_writable(output)
    log = import_table(table, TableMap.load(map_name), output)
    low, high = float(log.duty_pct.min()), float(log.duty_pct.max())
    seconds = float(log.time_s[-1] - log.time_s[0])
    duty = f"{low:.4g} %" if low == high else f"{low:.4g} to {high:.4g} %"
    bottom, top, unit = float(log.output.min()), float(log.output.max()), log.output_unit
    resolution = f", resolution {log.output_quantum:.4g} {unit}" if log.output_quantum else ""
    say(f"{output}: {len(log)} rows, {seconds:.4g} s at {log.sample_time_s:.6g} s")
    say(f"  duty {duty}, {log.output_name} {bottom:.6g} to {top:.6g} {unit}{resolution}")
    for note in log.dropped:
        say(f"  note: {note}")
    say.json(
        {
            "schema": "fiohost.import/1",
            "log": output,
            "sha256": log.sha256,
            "table": table,
            "map": map_name,
            "rows": len(log),
            "seconds": seconds,
            "sample_time_s": log.sample_time_s,
            "command_delay_ticks": log.command_delay_ticks,
            "duty_pct": [low, high],
            "output": log.output_name,
            "output_unit": unit,
            "output_range": [bottom, top],
            "output_quantum": log.output_quantum,
            "output_average": log.output_average,
            "notes": log.dropped,
        }
    )


@click.command()
@click.argument("name", required=False)
@json_option
def effects(name: str | None, json_to: str | None) -> None:
    """List the effects that a model can have, or explain the one called NAME.

    \b
    Examples:
      fiohost effects
      fiohost effects gravity_load
    """
    from fiohost.motor.effect import effect
    from fiohost.motor.effect import effects as library

    say = output_for(json_to)
    if name is None:
        chosen = list(library().values())
        _print_list(say, chosen)
    else:
        chosen = [effect(name)]
        _print_one(say, chosen[0])
    say.json({"schema": "fiohost.effects/1", "effects": [_as_dict(item) for item in chosen]})


def _print_list(say: Output, items: Sequence[Effect]) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim")
    for heading in ("effect", "what it is", "parameters"):
        table.add_column(heading, overflow="fold")
    for item in items:
        table.add_row(item.name, item.summary, ", ".join(p.name for p in item.parameters))
    say.console.print(table)
    say("\nfiohost effects NAME shows the equation, units, bounds, and what the effect cannot be told from.")


def _print_one(say: Output, item: Effect) -> None:
    say(f"{item.name}: {item.summary}")
    say(f"  equation    {item.equation}")
    for label, text in (("acts on", item.acts_on), ("signature", item.signature)):
        if text:
            say(f"  {label:<11} {text}")
    if item.equivalents:
        say(f"  the same as {', '.join(item.equivalents)}: no log can tell them apart")
    for parameter in item.parameters:
        say(f"  {parameter.name:<22} {_range(parameter)}")
    say(f"  source      {item.source}")


def _range(parameter: Parameter) -> str:
    if parameter.choices:
        return f"one of {', '.join(parameter.choices)}"
    unit = f" {parameter.unit}" if parameter.unit else ""
    return f"{parameter.lower:g} to {parameter.upper:g}{unit}"


def _as_dict(item: Effect) -> dict[str, Any]:
    return {
        "name": item.name,
        "summary": item.summary,
        "equation": item.equation,
        "acts_on": item.acts_on,
        "signature": item.signature,
        "equivalents": item.equivalents,
        "source": item.source,
        "parameters": [
            {"name": p.name, "unit": p.unit, "choices": p.choices}
            if p.choices
            else {"name": p.name, "unit": p.unit, "lower": p.lower, "upper": p.upper, "start": p.start}
            for p in item.parameters
        ],
    }
