"""``fiohost export``: a model, and a controller, for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from fiohost.cli.options import PATH, parse_number
from fiohost.cli.output import json_option, output_for
from fiohost.errors import ConfigError
from fiohost.files import claim, write_output
from fiohost.settings import nearest

KINDS = {".h": "C header", ".m": "MATLAB script", ".fmu": "FMU (FMI 3.0, co-simulation)"}


@click.command()
@click.argument("model", metavar="MODEL")
@click.option(
    "--controller", type=PATH, metavar="FILE", help="Controller file (design --save) to put beside the model."
)
@click.option("--sample-time", default="0.005", show_default=True, metavar="S", help="Tick of the controller.")
@click.option("-o", "--output", required=True, type=PATH, metavar="F", help="What to write: .m, .fmu, or .h.")
@json_option
def export(model: str, controller: Path | None, sample_time: str, output: Path, json_to: str | None) -> None:
    """Write MODEL (a model file, a name or an expression) for another program; the end of the name says which.

    .m: a MATLAB script without a toolbox, also for GNU Octave: the linear part, with --controller the loop. .fmu: the
    whole model with all its effects, for Simulink, OpenModelica and others; it needs pythonfmu3, and fiohost where it
    runs. .h: the controller alone, as C for firmware.

    \b
    Examples:
      fiohost export found.toml -o motor.fmu
      fiohost export found.toml --controller pd.toml -o loop.m
      fiohost export found.toml --controller pd.toml -o controller.h
    """
    say = output_for(json_to)
    kind = output.suffix.lower()
    if kind not in KINDS:
        raise ConfigError(f"{output}: what it shall be is told by its end; {nearest(kind or '.', KINDS)}")
    if controller is None and kind == ".h":
        raise ConfigError("a .h is a controller: --controller says which")
    if controller is not None and kind == ".fmu":
        raise ConfigError("an FMU is a model alone: leave --controller away")
    tick_s = parse_number("--sample-time", sample_time, 1e-5, 10.0, "s")
    claim(output)
    from fiohost.control.settings import ControlSettings
    from fiohost.motor.model import Model

    motor = Model.parse(model)
    settings = None if controller is None else ControlSettings.load(controller)
    if kind == ".fmu":
        from fiohost.export.fmu import write_fmu

        write_fmu(motor, output)
    elif kind == ".m":
        from fiohost.export.matlab import matlab_script

        write_output(output, matlab_script(motor, settings, tick_s))
    elif settings is not None:
        from fiohost.export.c_code import controller_c

        write_output(output, controller_c(settings, tick_s, comment=motor.expression))
    say(f"{output}: {KINDS[kind]} of {motor.expression if kind != '.h' else controller}")
    if kind == ".m" and motor.effects:
        say(f"  note: simulated there is the linear part alone, without {', '.join(motor.effects)}")
    say.json({"schema": "fiohost.export/1", "output": output, "kind": kind[1:], "model": motor.expression})
