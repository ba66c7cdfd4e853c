"""Commands on logs: ``diagnose`` and ``simulate``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fiohost.cli.options import PATH, expanded, parse_seed
from fiohost.cli.output import json_option, output_for
from fiohost.cli.progress import progress
from fiohost.cli.tables import Told, table_options
from fiohost.errors import ConfigError, ModelError
from fiohost.files import claim, report_folder

if TYPE_CHECKING:
    from fiohost.bench.log import Log
    from fiohost.discover.diagnose import Diagnosis


@click.command()
@click.argument("logs", nargs=-1, type=PATH, metavar="[LOG]...")
@click.option(
    "--readings",
    multiple=True,
    type=PATH,
    metavar="FILE",
    help="A readings file, a table of figures instead of logs; repeat it for more.",
)
@click.option(
    "--holdout",
    multiple=True,
    type=PATH,
    metavar="LOG",
    help="A log that only reports, a folder of such logs, or a pattern in quotes; repeat it for more.",
)
@click.option(
    "--model",
    default="linear",
    show_default=True,
    metavar="M",
    help="Declared model: linear+EFFECT+... or a model file.",
)
@json_option
@click.option("--save-model", type=PATH, metavar="FILE", help="Write the final model, for simulate.")
@click.option("--report", type=PATH, metavar="DIR", help="Write a page and plots into DIR.")
@table_options("The logs are foreign tables; MAP says how to read them.")
@click.option(
    "--limits", is_flag=True, help="Say how small an effect would have been seen, also where some were found."
)
@click.option(
    "--tolerance",
    default="0",
    metavar="P%",
    help="What is left below this share of the motion in windows of 1 s does not matter, as 1%.",
)
@click.option(
    "--own-seconds",
    default=10.0,
    show_default=True,
    metavar="S",
    help="So much of a held-out log's beginning says what is its own: gain, friction, load, dead time. 0: none.",
)
@click.option("--seed", default="0", show_default=True, metavar="N", help="Seed of the replicas that make the floor.")
@click.option(
    "--constants",
    metavar="SET|FILE",
    help="The motor's constants, as of lab characterise --save: the report says V, A and N m too.",
)
def diagnose(
    logs: Sequence[Path],
    readings: Sequence[Path],
    holdout: Sequence[Path],
    model: str,
    json_to: str | None,
    save_model: Path | None,
    report: Path | None,
    told: Told,
    limits: bool,
    tolerance: str,
    own_seconds: float,
    seed: str,
    constants: str | None,
) -> None:
    """Name what a declared model lacks, from logs, and report the error before and after on held-out ones; or from
    tables of readings.

    \b
    Examples:
      fiohost diagnose run1.csv run2.csv --holdout run3.csv --model linear+coulomb_friction
      fiohost diagnose power_*0.csv --holdout 'power_*5.csv' --map nxt_open_loop --report out
      fiohost diagnose --readings responses.toml --model nxt.toml --report out
    """
    if not logs and not readings:
        raise click.UsageError("Missing argument 'LOG...', or --readings FILE.")
    if readings:
        of_logs = {"LOG": logs, "--holdout": holdout, told.option: told, "--limits": limits, "--constants": constants}
        _refuse_with_readings(of_logs)
        _diagnose_readings(readings, model, json_to, save_model, report, seed)
        return
    from fiohost.circle.evidence import diagnose as run_diagnosis
    from fiohost.discover.result import to_json
    from fiohost.importing.automatic import understood
    from fiohost.labs.constants import MotorConstants
    from fiohost.motor.model import Model
    from fiohost.report.physical import constants_of
    from fiohost.report.tables import print_diagnosis

    say = output_for(json_to)
    declared, drawn = Model.parse(model), parse_seed(seed) or 0
    train, held_out = expanded(logs, "LOG"), expanded(holdout, "--holdout")
    if save_model is not None:
        claim(save_model)
    if report is not None:
        report_folder(report)

    known = MotorConstants.load(constants) if constants else None
    heads: list[Mapping[str, str]] = []

    def announce(train: Sequence[Log], held: Sequence[Log]) -> None:
        heads.extend(log.metadata for log in (*train, *held))
        for role, group in (("training", train), ("held out", held)):
            for log in group:
                say(f"{role:9} {log.path}: {len(log)} rows")
                if understood(log):
                    say(f"          understood: {understood(log)}")
                for note in log.dropped:
                    say(f"          dropped: {note}")

    with progress() as doing:
        found = run_diagnosis(
            train,
            held_out,
            declared,
            table_map=told.how,
            seed=drawn,
            limits=limits,
            tolerance_pct=_percent(tolerance),
            own_seconds=own_seconds,
            say=doing,
            announce=announce,
        )
    result = {**to_json(found), "constants": constants_of(heads, known).to_json()}
    try:
        print_diagnosis(say.console, result, say.verbose)
        if limits and not result["detection_limits"]:
            say("no detection limits: while something is unexplained, it hides what else may be there")
    finally:  # who reads along may leave before the end, as head does, and has asked for the files too
        if save_model is not None:
            found.in_hand.write(save_model, f"fitted by fiohost diagnose to {len(found.train)} logs")
        say.json(result)  # before the pictures, so that a full disk does not cost the result
        if report is not None:
            _write_report(report, found, result)
    if save_model is not None:
        say(f"model written to {save_model}")
    if report is not None:
        say(f"page and plots in {report}")


def _write_report(folder: Path, found: Diagnosis, result: Mapping[str, Any]) -> None:
    from fiohost.report.diagnosis import curves_of, series_of
    from fiohost.report.page import write_page
    from fiohost.report.plots import save_plots

    series, curves = series_of(found), curves_of(found)
    save_plots(folder, series, result, curves)
    write_page(folder / "report.html", title="Diagnosis", diagnosis=result, series=series, curves=curves)


def _percent(text: str) -> float:
    """A share in percent, with or without its sign. Raises ConfigError."""
    try:
        value = float(text.strip().removesuffix("%"))
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 100.0:
        raise ConfigError(f"--tolerance {text} is no share from 0 to below 100 %; write it as 1%")
    return value


def _refuse_with_readings(given: Mapping[str, object]) -> None:
    """Refuse what is for logs only. Raises ConfigError."""
    for name, value in given.items():
        if value:
            raise ConfigError(f"{name} does not go with --readings: logs and tables of readings are diagnosed apart")


def _diagnose_readings(
    readings: Sequence[Path], model: str, json_to: str | None, save_model: Path | None, report: Path | None, seed: str
) -> None:
    """``diagnose`` on tables of readings."""
    from fiohost.circle.readings import diagnose_readings
    from fiohost.discover.tables.table import Table
    from fiohost.report.readings import print_readings, readings_curves

    say = output_for(json_to)
    drawn = parse_seed(seed) or 0
    if save_model is not None:
        claim(save_model)
    if report is not None:
        report_folder(report)

    def announce(tables: Sequence[Table]) -> None:
        for table in tables:
            figures = ", ".join(f.name for f in table.figures)
            say(f"readings  {table.name}: {len(table.rows)} rows of {figures}")

    with progress() as doing:
        found = diagnose_readings(readings, model, seed=drawn, say=doing, announce=announce)
    result = found.to_json()
    print_readings(say.console, result)
    if save_model is not None:
        found.final.fit.model.write(save_model, f"fitted by fiohost diagnose to {len(readings)} readings files")
        say(f"model written to {save_model}")
    say.json(result)  # before the pictures, so that a full disk does not cost the result
    if report is not None:
        from fiohost.report.plots import save_plots

        save_plots(report, [], result, readings_curves(result))
        say(f"plots in {report}")


@click.command()
@click.argument("log", type=PATH)
@click.option(
    "--model", required=True, metavar="FILE", help="A model file (from diagnose --save-model) or an expression."
)
@click.option("-o", "--output", required=True, type=PATH, metavar="OUT.csv", help="Table to write.")
@table_options("LOG is a foreign table; MAP says how to read it.")
@click.option("--within", is_flag=True, help="Refuse a log that goes beyond what the model was fitted to.")
@json_option
def simulate(log: Path, model: str, output: Path, told: Told, within: bool, json_to: str | None) -> None:
    """Free run of a saved model on a log's commands, so that anyone can check the figures.

    A model file says what duties, speeds and holds it was fitted to. A log that goes beyond them is simulated with a
    note; with --within it is refused.

    \b
    Examples:
      fiohost simulate run3.csv --model found.toml -o simulated.csv
      fiohost simulate run4.csv --model found.toml -o simulated.csv --within
    """
    from fiohost.circle.evidence import read_logs
    from fiohost.circle.replay import replay, write_replay
    from fiohost.motor.model import Model
    from fiohost.report.words import listed

    say = output_for(json_to)
    claim(output)
    chosen = Model.parse(model)
    (source,) = read_logs([log], told.how)
    found = replay(source, chosen)
    if within and chosen.seen is None:
        raise ModelError(f"{model} does not say what it was fitted to, so nothing is known to be within it")
    if within and found.beyond:
        raise ModelError(f"{log} goes beyond what the model was fitted to: {listed(found.beyond)}")
    write_replay(output, found, source, model)
    errors = found.errors
    say(
        f"{output}: {len(found.output)} rows of {found.output_name}; against the log {errors.free_run_rms:.4g} "
        f"{found.unit} rms over the whole run, {errors.window_rms:.4g} {found.unit} in 1 s windows"
    )
    for note in found.beyond:
        say(f"note: the model extrapolates: {note}")
    for note in source.dropped:
        say(f"note: {source.path}: left out or doubtful: {note}")
    say.json(
        {
            "schema": "fiohost.simulation/1",
            "dropped": source.dropped,
            "extrapolates": list(found.beyond),
            "log": str(log),
            "model": chosen.expression,
            "output": str(output),
            "output_unit": found.unit,
            "initial": found.start._asdict(),
            "errors": errors.to_json(),
        },
    )
