"""``fiohost plot``: logs as a picture or as a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from fiohost.cli.options import PATH, expanded
from fiohost.cli.output import json_option, output_for
from fiohost.cli.tables import Told, table_options
from fiohost.errors import ConfigError
from fiohost.files import FreeName, claim, write_output

MOST_LOGS = 12
SUFFIXES = (".png", ".svg", ".pdf", ".html")


@click.command()
@click.argument("logs", nargs=-1, required=True, type=PATH, metavar="LOG...")
@click.option("--phase", is_flag=True, help="Speed over angle, in place of all over time.")
@click.option("--spectrum", is_flag=True, help="Amplitude over frequency, in place of all over time.")
@click.option("--against", metavar="M", help="A model beside it: a file from diagnose --save-model, or an expression.")
@table_options("The logs are foreign tables; MAP says how to read them.")
@click.option(
    "-o", "--output", type=PATH, metavar="F", help="Picture (.png, .svg, .pdf) or page (.html).  [default: LOG.png]"
)
@json_option
def plot(
    logs: Sequence[Path],
    phase: bool,
    spectrum: bool,
    against: str | None,
    told: Told,
    output: Path | None,
    json_to: str | None,
) -> None:
    """Draw logs: angle, speed, duty and what was measured beside, over time; several logs in one picture.

    A page (.html) needs no network: drag zooms, the cursor reads all curves. Any table that import understands is
    taken too.

    \b
    Examples:
      fiohost plot run.csv
      fiohost plot run.csv --against found.toml -o run.html
      fiohost plot monday.csv tuesday.csv --spectrum -o compared.svg
    """
    say = output_for(json_to)
    if phase and spectrum:
        raise ConfigError("--phase and --spectrum are two pictures: ask for one after the other")
    if output is not None and output.suffix.lower() not in SUFFIXES:
        raise ConfigError(f"{output}: a picture ends with {', '.join(SUFFIXES[:-1])}, a page with {SUFFIXES[-1]}")
    page = output is not None and output.suffix.lower() == ".html"
    if page and (phase or spectrum):
        raise ConfigError("a page shows logs over time; --phase and --spectrum make pictures")
    given = expanded(logs, "LOG")
    if len(given) > MOST_LOGS:
        raise ConfigError(f"{len(given)} logs in one picture: at most {MOST_LOGS}")
    if output is not None:
        claim(output)
    from fiohost.circle.evidence import read_logs, unique_names
    from fiohost.report.log_series import LogSeries, series_of

    read = read_logs(given, told.how)
    series: list[LogSeries] = []
    for log, name in zip(read, unique_names(read), strict=True):
        simulated = None
        if against is not None:
            from fiohost.circle.replay import replay
            from fiohost.motor.model import Model

            simulated = replay(log, Model.parse(against)).output
        series.append(series_of(log, name, simulated, Path(against).name if against else ""))
    title = ", ".join(one.name for one in series)[:110]
    wanted = output or FreeName(Path(f"{given[0].stem}{'_phase' if phase else '_spectrum' if spectrum else ''}.png"))
    if page:
        from fiohost.report.log_page import log_page

        written = write_output(wanted, log_page(series, title))
    else:
        from fiohost.report.log_plot import plot_logs, plot_phase, plot_spectrum
        from fiohost.report.pictures import save_figure

        draw = plot_phase if phase else plot_spectrum if spectrum else plot_logs
        written = save_figure(draw(series, title), wanted)
    for one, log in zip(series, read, strict=True):
        error = f"; {against}: {one.error_rms:.4g} {one.unit} rms" if one.error_rms is not None else ""
        say(f"{one.name}: {len(log)} rows, {log.time_s[-1] - log.time_s[0]:.4g} s{error}")
    say(f"{'page' if page else 'picture'}: {written}")
    errors = {one.name: one.error_rms for one in series if one.error_rms is not None}
    say.json({"schema": "fiohost.plot/1", "logs": given, "output": written, "against": against, "error_rms": errors})
