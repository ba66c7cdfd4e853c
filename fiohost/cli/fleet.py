"""``fiohost fleet``: many benches, each diagnosed, all of them compared."""

from __future__ import annotations

import os
from pathlib import Path

import click

from fiohost.cli.options import PATH, parse_seed, parse_whole
from fiohost.cli.output import json_option, output_for
from fiohost.cli.tables import Told, table_options


@click.command()
@click.argument("folder", type=PATH, metavar="FOLDER")
@click.option("--out", required=True, type=PATH, metavar="DIR", help="Where the table, the page and results go.")
@click.option(
    "--model",
    default="linear+coulomb_friction",
    show_default=True,
    metavar="M",
    help="Declared model of every bench: linear+EFFECT+... or a model file.",
)
@click.option("--fit-only", is_flag=True, help="Fit the declared model; do not look for what it lacks.")
@click.option("--processes", metavar="N", help="Local processes; otherwise one for each core.")
@click.option("--scheduler", metavar="ADDRESS", help="A Dask cluster instead, as tcp://host:8786.")
@click.option("--seed", default="0", show_default=True, metavar="N", help="Seed of the replicas that make the floor.")
@table_options("The logs are foreign tables; MAP says how to read them.")
@json_option
def fleet(
    folder: Path, out: Path, model: str, fit_only: bool, processes: str | None, scheduler: str | None, seed: str,
    told: Told, json_to: str | None,
) -> None:  # fmt: skip
    """Diagnose many benches: each folder of FOLDER is one (its logs in it, those that only report in holdout/), or each
    log where it has no folders; or each row of a table with columns bench and logs. Into DIR go fleet.parquet,
    fleet.html, and each bench's result at once: run it again and it goes on where it was.

    \b
    Examples:
      fiohost fleet line/ --out result --model motor.toml
      fiohost fleet benches.csv --out result --fit-only --full-scale 24
      fiohost fleet line/ --out result --scheduler tcp://10.0.0.5:8786
    """
    from fiohost.errors import ConfigError
    from fiohost.files import claim, make_folder, overwriting
    from fiohost.fleet.benches import find_benches
    from fiohost.fleet.page import write_fleet_page
    from fiohost.fleet.run import KEPT, run_fleet
    from fiohost.fleet.summary import summarised, write_table
    from fiohost.fleet.work import Settings
    from fiohost.importing.found import Answers
    from fiohost.motor.model import Model
    from fiohost.settings import find_config

    say = output_for(json_to)
    many = parse_whole("--processes", processes, 1, 1024) if processes else os.cpu_count() or 1
    benches = find_benches(folder)
    Model.parse(model)  # refused here, before any work
    is_expression = model.split("+")[0].strip() == "linear" and not model.endswith(".toml")
    text = None if is_expression else find_config("models", model).read_text(encoding="utf-8")
    answers = told.answers
    map_text = None if told.table_map is None else find_config("maps", told.table_map).read_text(encoding="utf-8")
    settings = Settings(
        model if is_expression else "", text, not fit_only, parse_seed(seed) or 0, map_text,
        answers if answers != Answers() else None,
    )  # fmt: skip
    make_folder(out)
    if os.path.samefile(folder, out):
        raise ConfigError(f"the results would lie among the benches: give --out another folder than {folder}")
    table, page = out / "fleet.parquet", out / "fleet.html"
    if not (out / KEPT).is_dir():  # what is there is of no earlier run
        for path in (table, page):
            claim(path)
    where = f"the cluster at {scheduler}" if scheduler else f"{many} local process{'es' if many > 1 else ''}"
    say(f"{len(benches)} benches on {where}")
    rows = run_fleet(benches, out, settings, processes=many, scheduler=scheduler, say=say)
    found = summarised(rows)
    with overwriting():  # both are made of what is kept beside them
        write_table(found, table)
        write_fleet_page(found, page)
    result = found.to_json()
    for name, count in found.effects.items():
        say(f"  {name}: {count} of {len(rows)} benches")
    for bench, what, z in found.apart[:20]:
        say(f"  apart: {bench}, {what} {z:+.1f} robust standard deviations")
    for name, slope in found.trends.items():
        say(f"  drift over {found.order_name}: {name} {slope['slope']:+.3g} each")
    for bench, why in found.failed[:20]:
        say(f"  not judged: {bench}: {why}")
    say(f"{len(rows)} benches, {len(found.apart)} apart, {len(found.failed)} not judged; table and page in {out}")
    say.json(result)
