"""``fiohost panel``: slider, stop buttons, dial and strip charts, in a window or in a browser."""

from __future__ import annotations

import click

from fiohost.cli.options import parse_number, parse_seed, parse_whole, target_options
from fiohost.cli.output import json_option, output_for
from fiohost.errors import ConfigError

SCHEMA = "fiohost.panel/1"
LOCAL = "127.0.0.1"


@click.command()
@target_options
@click.option("--web", is_flag=True, help="Show it in a browser instead of a window.")
@click.option(
    "--port", metavar="N", default="8988", show_default=True, help="With --web: the port; 0 takes a free one."
)
@click.option("--bind", metavar="ADDR", default=LOCAL, show_default=True,
              help="With --web: the address to serve at. All who can reach it can drive the motor.")  # fmt: skip
@click.option("--away", metavar="S", default="1", show_default=True,
              help="With --web: brake when no browser has been there for S seconds; never: keep driving.")  # fmt: skip
@click.option("--log", "log_to", metavar="F", help="Write every tick to this log.")
@click.option("--fast", is_flag=True, help="Do not keep real time on a simulated target.")
@json_option
def panel(
    target: str,
    seed: str | None,
    web: bool,
    port: str,
    bind: str,
    away: str,
    log_to: str | None,
    fast: bool,
    json_to: str | None,
) -> None:
    """Drive by hand with a slider, and watch angle, speed and duty.

    Brake, standby, reverse and emergency stop are buttons. Closing the window, Ctrl-C, or a panel that hangs or dies
    brakes the motor first; so does the last browser's leaving.

    \b
    Example:
      fiohost panel --target sim:nxt_no_load
      fiohost panel --web --log session.csv
    """
    out = output_for(json_to)
    options: dict[str, object] = {}
    if web:
        options = {"bind": bind, "port": parse_whole("--port", port, 0, 65535)}
        options["away_s"] = None if away == "never" else parse_number("--away", away, 0.1, 3600.0, "s, or never")
    elif (port, bind, away) != ("8988", LOCAL, "1"):
        raise ConfigError("--port, --bind and --away are for the panel in a browser: add --web")

    from fiohost.bench.connect import connect
    from fiohost.bench.stop import Stopped
    from fiohost.panel.session import WEB, WINDOW, run_panel

    with connect(target, seed=parse_seed(seed), realtime=not fast) as bench:
        name, ended = bench.transport.name, "complete"

        def say(where: str) -> None:
            out(f"{name}: panel {where}; Ctrl-C brakes and ends")

        try:
            rows = run_panel(bench, WEB if web else WINDOW, options, log_to, say)
            out(
                f"braked (C3 C4 = 1 1); {rows} ticks; {bench.statistics.describe()}"
                + (f"; log: {log_to}" if log_to else "")
            )
        except Stopped as exc:
            ended = str(exc)
            raise
        finally:
            result = {"schema": SCHEMA, "target": name, "ended": ended, "log": log_to}
            out.json(result | {"tick_statistics": bench.statistics.as_dict()})
