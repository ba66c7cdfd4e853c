"""The command about the library: ``effects``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fiohost.cli.output import json_option, output_for
from fiohost.cli.tables import Told, table_options

if TYPE_CHECKING:
    from fiohost.advice.limit import Measured
    from fiohost.cli.output import Output
    from fiohost.motor.effect import Effect, Parameter


@click.command()
@click.argument("what", nargs=-1, metavar="[NAME]... | check NAME... | --limits LOG...")
@click.option("--brief", is_flag=True, help="One line for each effect.")
@click.option("--limits", is_flag=True, help="Say how small an effect would show in the LOGs that follow.")
@click.option("--model", metavar="M", help="With --limits: the model that the logs are of.  [default: linear]")
@table_options("With --limits: the logs are foreign tables; MAP says how to read them.")
@json_option
def effects(what: Sequence[str], brief: bool, limits: bool, model: str | None, told: Told, json_to: str | None) -> None:
    """List the effects that a model can have: equation, what each does to a log, what it cannot be told from, and the
    smallest size that shows. With check: try an effect's bounds, neutral value, derivatives, steady speeds and energy.

    \b
    Examples:
      fiohost effects
      fiohost effects check backlash
      fiohost effects gravity_load
      fiohost effects --brief
      fiohost effects --limits run1.csv run2.csv --model linear+coulomb_friction
    """
    from fiohost.advice.limit import shipped
    from fiohost.motor.effect import effect
    from fiohost.motor.effect import effects as library

    if limits and not what:
        raise click.UsageError("--limits needs logs: fiohost effects --limits LOG...")
    if not limits and (model or told):
        raise click.UsageError("--model, --map and what is said of tables go with --limits LOG...")
    if what and what[0] == "check" and not limits:
        _check(what[1:], brief, json_to)
        return
    say = output_for(json_to)
    chosen = [effect(name) for name in what] if what and not limits else list(library().values())
    default, own = shipped(), None
    if limits:
        from fiohost.circle.detection import smallest_visible
        from fiohost.cli.progress import progress

        with progress() as doing:
            own = smallest_visible([Path(log) for log in what], model or "linear", table_map=told.how, say=doing)
    if brief or own:
        _print_table(say, chosen, default, own)
    else:
        for item in chosen:
            _print_one(say, item, default)
    of = "the suite of close-loop" if own is None else "the logs given, and the suite of close-loop"
    say(f"Smallest seen: what would have shown in {of}, {default.seconds:.0f} s on the {default.plant} plant.")
    say.json(
        {
            "schema": "fiohost.effects/1",
            "effects": [_as_dict(item, default, own) for item in chosen],
            "default_suite": _conditions(default),
            "given_logs": _conditions(own) if own else None,
        }
    )


def _check(names: Sequence[str], brief: bool, json_to: str | None) -> None:
    """Check effects and print a line for each check; leaves with 1 where one fails."""
    from dataclasses import asdict

    from fiohost.errors import ModelError
    from fiohost.motor.check import check_effect
    from fiohost.motor.effect import effect

    if not names or brief:
        raise click.UsageError("which effect? fiohost effects check NAME...")
    say = output_for(json_to)
    found = {name: check_effect(effect(name)) for name in names}
    for name, checks in found.items():
        say(f"{name}: {effect(name).summary}")
        for check in checks:
            say(f"  {'passed' if check.passed else 'FAILED'}  {check.name:<11} {check.said}")
    told = [{"name": name, "checks": [asdict(check) for check in checks]} for name, checks in found.items()]
    say.json({"schema": "fiohost.effect_checks/1", "effects": told})
    wrong = [f"{name} ({check.name})" for name, checks in found.items() for check in checks if not check.passed]
    if wrong:
        raise ModelError(f"not every check is passed: {', '.join(wrong)}")


def _smallest(measured: Measured, item: Effect) -> list[str]:
    """The limits of an effect in words, one for each of its kinds."""
    from fiohost.report.outlook import limit_words

    return [limit_words(limit.to_json()) for limit in measured.of(item.name)]


def _print_table(say: Output, items: Sequence[Effect], default: Measured, own: Measured | None) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim")
    shown = [("smallest seen (default suite)", default)]
    if own:
        shown.insert(0, ("smallest seen (these logs)", own))
    for heading in ("effect", *([] if own else ["what it is"]), *(name for name, _ in shown)):
        table.add_column(heading, overflow="fold")
    for item in items:
        sizes = ("\n".join(_smallest(measured, item)) for _, measured in shown)
        table.add_row(item.name, *([] if own else [item.summary]), *sizes)
    say.console.print(table)
    say()


def _print_one(say: Output, item: Effect, default: Measured) -> None:
    say(f"{item.name}: {item.summary}")
    say(f"  equation    {item.equation}")
    for label, text in (("acts on", item.acts_on), ("signature", item.signature)):
        if text:
            say(f"  {label:<11} {text}")
    if item.equivalents:
        say(f"  the same as {', '.join(item.equivalents)}: no log can tell them apart")
    for parameter in item.parameters:
        say(f"  {parameter.name:<22} {_range(parameter)}")
    for size in _smallest(default, item):
        say(f"  smallest seen (default suite): {size}")
    say(f"  source      {item.source}\n")


def _range(parameter: Parameter) -> str:
    if parameter.choices:
        return f"one of {', '.join(parameter.choices)}"
    unit = f" {parameter.unit}" if parameter.unit else ""
    return f"{parameter.lower:g} to {parameter.upper:g}{unit}"


def _conditions(measured: Measured) -> dict[str, object]:
    return {k: v for k, v in measured.to_json().items() if k not in ("schema", "limits")}


def _as_dict(item: Effect, default: Measured, own: Measured | None) -> dict[str, Any]:
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
        "detection_limits": {
            "default_suite": [limit.to_json() for limit in default.of(item.name)],
            "given_logs": [limit.to_json() for limit in own.of(item.name)] if own else None,
        },
    }
