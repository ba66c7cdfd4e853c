"""``fiohost design``: gains that meet a specification, in simulation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fiohost.cli.options import PATH, parse_number, profile_option
from fiohost.cli.output import json_option, output_for
from fiohost.errors import ConfigError
from fiohost.files import FreeName, claim, write_output

if TYPE_CHECKING:
    from fiohost.control.design import Design

EMITTED = {"c": "controller as C", "matlab": "model and controller as a MATLAB script"}


@click.command()
@click.option("--model", required=True, metavar="M", help="Model file (identify or diagnose --save-model), or a name.")
@click.option("--controller", default="pd", show_default=True, metavar="p|pd|pi|pid", help="Kind of controller.")
@click.option("--overshoot", default="5", show_default=True, metavar="PCT", help="Largest overshoot.")
@click.option("--settling", default="0.5", show_default=True, metavar="S", help="Longest settling time.")
@click.option("--sse", default="1", show_default=True, metavar="DEG", help="Largest steady-state error.")
@click.option("--band", default="2", show_default=True, metavar="PCT", help="Band of the settling time.")
@click.option("--steps", default="20,90,180", show_default=True, metavar="DEG,...", help="Sizes of the steps.")
@click.option("--limit", default="100", show_default=True, metavar="PCT", help="Largest duty.")
@profile_option
@click.option("--share", metavar="X", help="Share of the deadband to compensate.  [default: the profile's, else 0.8]")
@click.option("--counts", metavar="N", help="Errors up to N counts command nothing.  [default: 1 or 0]")
@click.option(
    "--derivative-on", default="angle", show_default=True, metavar="angle|error", help="What is differentiated."
)
@click.option("--sample-time", default="0.005", show_default=True, metavar="S", help="Tick of the loop.")
@click.option("--save", "save_to", type=PATH, metavar="FILE", help="Controller file for run.")
@click.option("--emit", metavar="c|matlab", help="Write the controller as C for firmware, or the loop as a script.")
@click.option("--emit-to", type=PATH, metavar="F", help="With --emit: the file.  [default: fiohost_controller.h or .m]")
@click.option("--plot", "plot_to", type=PATH, metavar="F", help="Picture of the responses.")
@json_option
def design(
    model: str, controller: str, overshoot: str, settling: str, sse: str, band: str, steps: str, limit: str,
    profile: str | None, share: str | None, counts: str | None, derivative_on: str, sample_time: str,
    save_to: Path | None, emit: str | None, emit_to: Path | None, plot_to: Path | None, json_to: str | None,
) -> None:  # fmt: skip
    """Find gains whose step responses meet a specification on a model: with the limit of the duty, friction or
    deadband, its compensation, encoder counts, and a tick of delay. A specification that cannot be met is said so, with
    the nearest that can (exit code 0: that is a result).

    \b
    Examples:
      fiohost design --model nxt --controller pd --overshoot 5 --settling 0.5 --sse 1
      fiohost design --model motor.toml --profile bench.toml --save pd.toml --plot pd.png
      fiohost design --model motor.toml --emit c --emit-to controller.h
      fiohost run square_170_190 --controller pd.toml
    """
    out = output_for(json_to)
    if emit is not None and emit not in EMITTED:
        raise ConfigError(f"--emit {emit[:40]!r} is neither {' nor '.join(EMITTED)}")
    if emit_to is not None and emit is None:
        raise ConfigError("--emit-to needs --emit c or --emit matlab")
    for path in (save_to, plot_to, emit_to):
        if path is not None:
            claim(path)
    numbers = {
        "overshoot_pct": parse_number("--overshoot", overshoot, 0.001, 500.0, "percent"),
        "settling_s": parse_number("--settling", settling, 0.001, 60.0, "s"),
        "sse_deg": parse_number("--sse", sse, 0.001, 360.0, "deg"),
        "band_pct": parse_number("--band", band, 0.001, 50.0, "percent"),
        "limit_pct": parse_number("--limit", limit, 0.1, 100.0, "percent"),
        "sample_time_s": parse_number("--sample-time", sample_time, 1e-4, 1.0, "s"),
    }
    sizes = [parse_number("--steps", size.strip(), 0.001, 1e5, "deg") for size in steps.split(",")]
    part = None if share is None else parse_number("--share", share, 0.0, 1.5)
    threshold = None if counts is None else parse_number("--counts", counts, 0.0, 100.0)
    if derivative_on not in ("angle", "error"):
        raise ConfigError(f"--derivative-on {derivative_on[:40]!r} is neither angle nor error")

    from fiohost.bench.profile import SHARE, BenchProfile
    from fiohost.control.design import deadband_of, with_deadband
    from fiohost.control.design import design as run
    from fiohost.motor.model import Model

    motor = Model.parse(model)
    if profile is not None:
        bench = BenchProfile.load(profile)
        motor = with_deadband(motor, bench.u_plus_pct, bench.u_minus_pct)
        deadband, usual = (bench.u_plus_pct, bench.u_minus_pct), bench.share
    else:
        deadband, usual = deadband_of(motor), SHARE
    part = usual if part is None else part
    found = run(
        motor, controller, steps_deg=sizes, compensation_pct=(part * deadband[0], part * deadband[1]),
        derivative_on=derivative_on, threshold_counts=threshold, **numbers,
    )  # fmt: skip
    out(str(found))
    if save_to is not None:
        found.settings.save(save_to, f"designed by fiohost for {found.model.expression}")
        out(f"controller written to {save_to}; fiohost run square_170_190 --controller {save_to}")
    if emit is not None:
        emit_to = _emit(found, emit, emit_to)
        out(f"{EMITTED[emit]} written to {emit_to}")
    if plot_to is not None:
        from fiohost.report.design import plot_design
        from fiohost.report.pictures import save_figure

        save_figure(plot_design(found, f"{controller.upper()} on {found.model.expression}"), plot_to)
        out(f"plot: {plot_to}")
    out.json(found.to_json() | {"controller_file": save_to, "plot": plot_to, "emitted": emit_to})


def _emit(found: Design, kind: str, path: Path | None) -> Path:
    """Write the controller as C, or model and controller as a MATLAB script. Gives the name."""
    from fiohost.export.c_code import controller_c
    from fiohost.export.matlab import matlab_script

    if kind == "c":
        text = controller_c(found.settings, found.sample_time_s, comment=found.model.expression)
        return write_output(path or FreeName(Path("fiohost_controller.h")), text)
    text = matlab_script(found.model, found.settings, found.sample_time_s, max(s.step_deg for s in found.found))
    return write_output(path or FreeName(Path("fiohost_loop.m")), text)
