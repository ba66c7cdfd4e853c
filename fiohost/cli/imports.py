"""``fiohost import``: a log of any table, with the map that is found or given."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from fiohost.cli.options import PATH
from fiohost.cli.output import Output, json_option, output_for
from fiohost.cli.progress import progress
from fiohost.cli.tables import Told, table_options
from fiohost.errors import ConfigError, DataError
from fiohost.files import claim, write_output
from fiohost.settings import counted

if TYPE_CHECKING:
    from fiohost.bench.log import Log
    from fiohost.importing.found import Answers
    from fiohost.importing.raw import RawTable
    from fiohost.importing.understand import Understanding

MOST_ROUNDS = 12  # of questions
PICTURE = ".png"


@click.command("import")
@click.argument("table", type=PATH)
@table_options("Map file, or the name of a shipped one.  [default: it is found]")
@click.option("--yes", is_flag=True, help="Take what is found without asking.")
@click.option(
    "-o", "--output", type=PATH, metavar="LOG", help="Log to write.  [default: TABLE_log.csv, or the first free]"
)
@click.option("--plot", "plot_to", type=PATH, metavar="F", help="Picture of the log.  [default: beside the log]")
@json_option
def import_(table: Path, told: Told, yes: bool, output: Path | None, plot_to: Path | None, json_to: str | None) -> None:
    """Make a log of any table of numbers: CSV and other text, MATLAB (.mat), HDF5, Parquet.

    Without --map the table is looked at: delimiter, decimal mark, encoding, title rows, names, units, dates, which
    column is time, command and measured, full scale, resolution, turns. What was found is printed and drawn, and the
    map that was used is written beside the log. In a terminal you are asked about what cannot be known; elsewhere --yes
    takes what was found, and what stays unknown is refused in one sentence.

    \b
    Examples:
      fiohost import messung.csv
      fiohost import run7.csv --yes --full-scale 24 -o run7_log.csv
      fiohost import power_040.csv --map nxt_open_loop -o log_040.csv
    """
    say = output_for(json_to)
    answers, map_name = told.answers, told.table_map
    if map_name is not None:
        _with_map(say, table, map_name, output, plot_to)
        return
    from fiohost.importing.automatic import says_it_is_a_log
    from fiohost.importing.read import read_raw

    if says_it_is_a_log(table):
        from fiohost.bench.log import Log

        log = Log.read(table)  # says what is wrong with it, if anything is
        raise DataError(f"{table} is a log of fiohost already, of {len(log)} rows: there is nothing to import")
    with progress() as doing:
        doing(f"reading {table.name}")
        raw = read_raw(table)
    found = _asked(say, raw, answers, yes)
    output = output or _free(table)
    map_to, picture = output.with_name(f"{output.stem}.map.toml"), plot_to or output.with_suffix(PICTURE)
    for path in (output, map_to, picture):
        claim(path)
    from fiohost.importing.convert import import_raw

    table_map = replace(found.certain, name=map_to.stem.removesuffix(".map"))
    with progress() as doing:
        doing(f"writing {output.name}")
        log = import_raw(found.table, table_map, output, found.sentences)
    write_output(map_to, table_map.to_toml((f"found for {table.name} by fiohost import", *found.sentences)))
    _say_log(say, output, log)
    _draw(log, picture, f"{table.name}: what was understood", found.sentences)
    say(f"  map: {map_to}; picture: {picture}")
    shown = {
        "map_file": map_to,
        "picture": picture,
        "understood": found.lines,
        "assumed": found.assumed,
        "form": found.table.form,
    }
    say.json(_result(log, output, table, str(map_to)) | shown)


def _with_map(say: Output, table: Path, map_name: str, output: Path | None, plot_to: Path | None) -> None:
    from fiohost.importing.convert import import_table
    from fiohost.importing.map import TableMap

    output = output or _free(table)
    claim(output)
    if plot_to is not None:
        claim(plot_to)
    log = import_table(table, TableMap.load(map_name), output)
    _say_log(say, output, log)
    if plot_to is not None:
        _draw(log, plot_to, table.name, ())
        say(f"  picture: {plot_to}")
    say.json(_result(log, output, table, map_name) | {"picture": plot_to})


def _asked(say: Output, raw: RawTable, answers: Answers, yes: bool) -> Understanding:
    """What the table is, asked for where somebody is there to answer. Raises DataError."""
    from fiohost.importing.understand import understand

    asks = not yes and sys.stdin is not None and sys.stdin.isatty() and say.is_terminal
    found = understand(raw, answers)
    say(f"{raw.path}: {found.lines[0]}")
    for _ in range(MOST_ROUNDS):
        if not found.unknown or not asks:
            break
        answers = _question(found, answers)
        try:
            found = understand(raw, answers)
        except ConfigError as exc:
            say(f"  {exc}")
            answers = found.answers
    for line in found.lines[1:]:
        say(f"  {line}")
    for line in found.assumed:
        say(f"  assumed: {line}")
    _ = found.certain
    if found.assumed and not yes:
        if not asks:
            many = f"{counted(len(found.assumed), 'thing')} {'is' if len(found.assumed) == 1 else 'are'}"
            raise DataError(f"{raw.path}: {many} assumed, see above: say --yes to take what is found")
        click.confirm("Take it?", default=True, abort=True, err=True)
    return found


def _question(found: Understanding, answers: Answers) -> Answers:
    """One question, and the answers with its answer."""
    one = found.unknown[0]
    if one.choices:
        click.echo(f"one of: {', '.join(one.choices[:30])}", err=True)
    if one.key == "names":
        click.echo(f"columns: {', '.join(found.table.names[:30])}", err=True)
        command = click.prompt("Which column is the command", err=True)
        return replace(answers, command=command, output=click.prompt("Which column is measured", err=True))
    if one.key in ("full_scale", "counts_per_rev", "sample_time_s"):
        words = {
            "full_scale": "What is 100 %, in the column's own unit",
            "counts_per_rev": "Counts of a turn",
            "sample_time_s": "Seconds between rows",
        }
        click.echo(f"unknown: {one.what}", err=True)
        told: float = click.prompt(words[one.key], type=click.FloatRange(min=1e-9), err=True)
        if one.key == "full_scale":
            return replace(answers, full_scale=told)
        return (
            replace(answers, counts_per_rev=told)
            if one.key == "counts_per_rev"
            else replace(answers, sample_time_s=told)
        )
    click.echo(f"unknown: {one.what}", err=True)
    said: str = click.prompt({"output": "Measured column", "command": "Command"}.get(one.key, "Unit"), err=True)
    if one.key == "unit":
        return replace(answers, unit=said)
    return replace(answers, command=said) if one.key == "command" else replace(answers, output=said)


def _free(table: Path) -> Path:
    """A name in the folder one is in, of which log, map and picture are all free."""
    number = 1
    while True:
        path = Path(f"{table.stem}_log{'' if number == 1 else f'-{number}'}.csv")
        if not any(p.exists() for p in (path, path.with_suffix(PICTURE), path.with_name(f"{path.stem}.map.toml"))):
            return path
        number += 1


def _draw(log: Log, path: Path, title: str, lines: tuple[str, ...] | list[str]) -> None:
    from fiohost.report.log_plot import plot_logs
    from fiohost.report.log_series import series_of
    from fiohost.report.pictures import save_figure

    save_figure(plot_logs([series_of(log)], title, lines), path)


def _say_log(say: Output, output: Path, log: Log) -> None:
    low, high = float(log.duty_pct.min()), float(log.duty_pct.max())
    seconds = float(log.time_s[-1] - log.time_s[0])
    duty = f"{low:.4g} %" if low == high else f"{low:.4g} to {high:.4g} %"
    bottom, top, unit = float(log.output.min()), float(log.output.max()), log.output_unit
    resolution = f", resolution {log.output_quantum:.4g} {unit}" if log.output_quantum else ""
    say(f"{output}: {len(log)} rows, {seconds:.4g} s at {log.sample_time_s:.6g} s")
    say(f"  duty {duty}, {log.output_name} {bottom:.6g} to {top:.6g} {unit}{resolution}")
    for note in log.dropped:
        say(f"  note: {note}")


def _result(log: Log, output: Path, table: Path, map_name: str) -> dict[str, object]:
    return {
        "schema": "fiohost.import/1",
        "log": output,
        "sha256": log.sha256,
        "table": table,
        "map": map_name,
        "rows": len(log),
        "seconds": float(log.time_s[-1] - log.time_s[0]),
        "sample_time_s": log.sample_time_s,
        "command_delay_ticks": log.command_delay_ticks,
        "duty_pct": [float(log.duty_pct.min()), float(log.duty_pct.max())],
        "output": log.output_name,
        "output_unit": log.output_unit,
        "output_range": [float(log.output.min()), float(log.output.max())],
        "output_quantum": log.output_quantum,
        "output_average": log.output_average,
        "notes": log.dropped,
    }
