"""``fiohost deadband``: at which duty the motor starts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from fiohost.cli.options import parse_number, parse_seed, parse_whole, target_options
from fiohost.cli.output import check_writable, json_option, output_for

if TYPE_CHECKING:
    from fiohost.bench.deadband import Onset


@click.command()
@target_options
@click.option("--repeats", default="5", show_default=True, metavar="N", help="Sweeps in each direction, 1 to 100.")
@click.option("--max", "most", default="100", show_default=True, metavar="PCT", help="Largest duty to try.")
@click.option("--plot", "plot_to", default="deadband.png", show_default=True, metavar="F", help="Picture to save.")
@click.option("--realtime", is_flag=True, help="Keep real time on a simulated target too.")
@json_option
def deadband(
    target: str,
    seed: str | None,
    repeats: str,
    most: str,
    plot_to: str,
    realtime: bool,
    json_to: str | None,
) -> None:
    """Find the duty at which the motor starts from rest, in both directions, by slow ramps.

    u_plus is above 0, u_minus below; the spread is the standard deviation over the repeats, which start at different
    angles of the shaft. For a precompensator (Eq. 2.6 of the lab text) take somewhat less than what is found.

    \b
    Example:
      fiohost deadband --repeats 8 --plot deadband.png
    """
    count = parse_whole("--repeats", repeats, 1, 100)
    max_pct = parse_number("--max", most, 1.0, 100.0, "percent of full scale")
    out = output_for(json_to)
    check_writable(plot_to)

    from fiohost.bench.connect import connect
    from fiohost.bench.deadband import measure_deadband

    def line(onset: Onset) -> None:
        way = "forward" if onset.forward else "reverse"
        out(f"{way:<9s}  {onset.duty_pct:9.2f} %    {onset.at_angle_deg:8.1f} deg")

    with connect(target, seed=parse_seed(seed), realtime=realtime) as bench:
        name = bench.transport.name
        out(f"{name}: ramps from rest, {count} in each direction\ndirection  starts at    shaft at rest at")
        found = measure_deadband(bench, count, max_pct, progress=line)
    out()
    out("          mean       spread   smallest .. largest")
    for sign, forward in (("u_plus ", True), ("u_minus", False)):
        duties = sorted(found.duties(forward), key=abs)
        mean = found.u_plus_pct if forward else found.u_minus_pct
        spread = found.spread_pct(forward)
        out(f"{sign}  {mean:7.2f} %   {spread:7.3f} %  {duties[0]:.2f} .. {duties[-1]:.2f} %")
    for note in found.notes():
        out(f"note: {note}")

    from fiohost.report.deadband import save_deadband_plot

    save_deadband_plot(found, name, plot_to)
    out(f"plot: {plot_to}")
    out.json({**found.as_dict(), "target": name, "plot": plot_to})
