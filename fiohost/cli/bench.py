"""Commands about simulated boards: ``plants`` and ``unseal``."""

from __future__ import annotations

from typing import Any

import click

from fiohost.cli.output import json_option, output_for


@click.command()
@json_option
def plants(json_to: str | None) -> None:
    """List the plants of the simulated board, each with the source of its constants.

    \b
    Example:
      fiohost plants
      fiohost manual --pwm 40 --target sim:nxt_no_load
    """
    from fiohost.transport.simulated import DEFAULT_PLANT, list_plants

    out = output_for(json_to)
    found = list_plants()
    for plant in found:
        default = " (default)" if plant["name"] == DEFAULT_PLANT else ""
        out(f"sim:{plant['name']}{default}\n    {plant['source']}")
    out.json({"schema": "fiohost.plants/1", "default": DEFAULT_PLANT, "plants": found})


@click.command()
@click.argument("seed_or_log")
@click.option("--version", type=int, metavar="V", help="Version of the draws; by default a log's own, else the newest.")
@json_option
def unseal(seed_or_log: str, version: int | None, json_to: str | None) -> None:
    """Show what a sealed board was: SEED_OR_LOG is its seed, or a log of it made on this machine.

    \b
    Example:
      fiohost run multisine --target sim:sealed --log secret.csv
      fiohost unseal secret.csv
    """
    from fiohost.bench.seal import find_seed, find_version
    from fiohost.transport.instruments import break_seal

    out = output_for(json_to)
    seed = find_seed(seed_or_log)
    truth = break_seal(seed, find_version(seed_or_log) if version is None else version, faulty=True)
    sentences = truth.get("truth") or []
    out(f"seed {seed}: {', '.join(truth.get('effects') or []) or 'no effect'}")
    for sentence in sentences:
        out(f"  {sentence}")
    _tree(out, {k: v for k, v in truth.items() if k in ("si", "reduced")})
    _tree(out, {"faults, as sim:sealed-faulty": truth["faults"]})
    out.json({"schema": "fiohost.unseal/1", "seed": seed, **truth})


def _tree(out: Any, values: dict[str, Any], depth: int = 1) -> None:
    for key, value in values.items():
        if isinstance(value, dict):
            out(f"{'  ' * depth}{key}:")
            _tree(out, value, depth + 1)
        else:
            shown = f"{value:.6g}" if isinstance(value, float) else str(value)
            out(f"{'  ' * depth}{key} = {shown}")
