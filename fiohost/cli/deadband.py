"""``fiohost deadband``: at which duty the motor starts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fiohost.cli.options import parse_number, parse_seed, parse_whole, target_options
from fiohost.cli.output import json_option, output_for
from fiohost.errors import ConfigError
from fiohost.files import FreeName, claim
from fiohost.settings import nearest

if TYPE_CHECKING:
    from fiohost.bench.deadband import Onset

METHODS = ("ramp", "steps")


@click.command()
@target_options
@click.option(
    "--method", default="ramp", show_default=True, metavar="ramp|steps", help="Slow ramps, or steps from rest."
)
@click.option("--repeats", default="5", show_default=True, metavar="N", help="Sweeps in each direction, 1 to 100.")
@click.option(
    "--angles", default="0", metavar="N",
    help="In each sweep, starts at N angles of the turn.  [default: one, further on each time]",
)  # fmt: skip
@click.option("--max", "most", default="100", show_default=True, metavar="PCT", help="Largest duty to try.")
@click.option("--plot", "plot_to", metavar="F", help="Picture to save.  [default: deadband.png, or deadband-N.png]")
@click.option("--save", "save_to", metavar="FILE", help="Write a bench profile for design, run and the labs.")
@click.option("--realtime", is_flag=True, help="Keep real time on a simulated target too.")
@json_option
def deadband(
    target: str,
    seed: str | None,
    method: str,
    repeats: str,
    angles: str,
    most: str,
    plot_to: str | None,
    save_to: str | None,
    realtime: bool,
    json_to: str | None,
) -> None:
    """Find the duty at which the motor starts from rest, in both directions, by slow ramps or by steps.

    u_plus is above 0, u_minus below; the spread is the standard deviation over all starts, which are at different
    angles of the shaft. With --angles it is said apart how much the starts differ over the turn and how much between
    repeats at one place. For a precompensator (Eq. 2.6 of the INC451 lab text) take somewhat less than what is found.

    \b
    Examples:
      fiohost deadband --repeats 8 --plot deadband.png
      fiohost deadband --method steps --angles 6 --repeats 3 --save bench.toml
    """
    count = parse_whole("--repeats", repeats, 1, 100)
    places = parse_whole("--angles", angles, 0, 360)
    if method not in METHODS:
        raise ConfigError(f"--method {method[:40]!r} is unknown; {nearest(method, METHODS)}")
    max_pct = parse_number("--max", most, 1.0, 100.0, "percent of full scale")
    out = output_for(json_to)
    for output in (plot_to, save_to):
        if output is not None:
            claim(output)

    from fiohost.bench.connect import connect
    from fiohost.bench.deadband import measure_deadband

    def line(onset: Onset) -> None:
        way = "forward" if onset.forward else "reverse"
        out(f"{way:<9s}  {onset.duty_pct:9.2f} %    {onset.at_angle_deg:8.1f} deg")

    with connect(target, seed=parse_seed(seed), realtime=realtime) as bench:
        name = bench.transport.name
        what = "ramps" if method == "ramp" else "steps"
        at = f" at {places} angles" if places else ""
        out(f"{name}: {what} from rest, {count} in each direction{at}\ndirection  starts at    shaft at rest at")
        found = measure_deadband(bench, count, max_pct, progress=line, method=method, angles=places)
    out()
    out("          mean       spread   smallest .. largest")
    for sign, forward in (("u_plus ", True), ("u_minus", False)):
        duties = sorted(found.duties(forward), key=abs)
        mean = found.u_plus_pct if forward else found.u_minus_pct
        spread = found.spread_pct(forward)
        out(f"{sign}  {mean:7.2f} %   {spread:7.3f} %  {duties[0]:.2f} .. {duties[-1]:.2f} %")
    for sign, forward in (("u_plus ", True), ("u_minus", False)) if places else ():
        over_angle, over_repeats = found.spread_over_angle_pct(forward), found.spread_over_repeats_pct(forward)
        out(f"{sign}  spread over the turn {_pct(over_angle)}, between repeats at one place {_pct(over_repeats)}")
    for note in found.notes():
        out(f"note: {note}")

    from fiohost.report.deadband import plot_deadband
    from fiohost.report.pictures import save_figure

    plot = save_figure(plot_deadband(found, name), plot_to or FreeName(Path("deadband.png")))
    out(f"plot: {plot}")
    if save_to is not None:
        from fiohost.bench.profile import BenchProfile

        BenchProfile(
            name, method, max(found.u_plus_pct, 0.0), min(found.u_minus_pct, 0.0),
            found.spread_pct(True), found.spread_pct(False),
        ).save(save_to)  # fmt: skip
        out(f"bench profile: {save_to}")
    out.json({**found.as_dict(), "target": name, "plot": plot, "profile": save_to})


def _pct(value: float | None) -> str:
    return "not known" if value is None else f"{value:.3f} %"
