"""``fiohost lab``: the experiments of the two lab texts.

To add one: ``fiohost/labs/X.py`` (what it does), ``fiohost/cli/labs/X.py`` (its options), a page ``docs/labs/NAME.md``
and a line in LABS.
"""

from __future__ import annotations

from typing import Any

import click

from fiohost.cli.lazy import LazyCommands
from fiohost.cli.output import json_option, output_for
from fiohost.errors import ConfigError
from fiohost.settings import nearest

# name -> (module:attribute, short help)
LABS: dict[str, tuple[str, str]] = {
    "manual": ("fiohost.cli.labs.manual:manual", "Manual control: speed against duty, dead zone, brake and standby."),
    "elevator": ("fiohost.cli.labs.elevator:elevator", "Seven floors under gravity: P, PI, limited power, buttons."),
    "problems": ("fiohost.cli.labs.problems:problems", "The text's problems D-1 to D-19, answered by computation."),
    "characterise": ("fiohost.cli.labs.characterise:characterise", "Ra, Ki, Kb, B, J from readings, with intervals."),
    "open-loop-step": (
        "fiohost.cli.labs.control_lab:open_loop_step",
        "Steps of voltage: speed, lag, friction, inertia.",
    ),
    "open-loop-sine": (
        "fiohost.cli.labs.control_lab:open_loop_sine",
        "Gain, phase and Bode plot; a calculator on a log.",
    ),
    "speed-control": ("fiohost.cli.labs.control_lab:speed_control", "Speed by P and PI, a gear head, a disturbance."),
    "position-control": ("fiohost.cli.labs.control_lab:position_control", "Position by P, PI and PID; a PI designed."),
    "fine-tuning": (
        "fiohost.cli.labs.control_lab:fine_tuning",
        "J or B by the position response, poles, Eqs. D-15 on.",
    ),
    "design-project": ("fiohost.cli.labs.control_lab:design_project", "The arm that drops its payload into a cup."),
    "steps": ("fiohost.cli.labs.control_lab:steps", "Steps 1 to 25 of the control lab, each answered."),
    "precompensation": (
        "fiohost.cli.labs.precompensation:precompensation",
        "Deadband compensation against jitter and limit cycles.",
    ),
    "identification": ("fiohost.cli.labs.identification:identification", "K and tau from a closed loop, two ways."),
    "design": ("fiohost.cli.labs.design:design", "PD control to a specification: simulated, then run."),
    "tables": ("fiohost.cli.labs.tables:tables", "Tables of readings: before, missing effect, after, left out."),
    "grade": ("fiohost.cli.labs.grade:grade", "For teachers: models handed in against the students' sealed benches."),
    "list": ("fiohost.cli.lab:list_labs", "List the experiments."),
}


class Labs(LazyCommands):
    """An unknown name is refused with the nearest one, exit 1 as for any unknown name."""

    table = LABS

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args and args[0] not in LABS and not args[0].startswith("-"):
            raise ConfigError(f"unknown lab {args[0]!r}; {nearest(args[0], LABS)}")
        return super().resolve_command(ctx, args)


@click.group(cls=Labs, epilog="Example: fiohost lab list")
def lab() -> None:
    """Do an experiment of the two lab texts, on a real board or a simulated one."""


@click.command("list")
@json_option
def list_labs(json_to: str | None) -> None:
    """List the experiments with what each is about; a page on each is in docs/labs/.

    \b
    Example:
      fiohost lab list
    """
    out = output_for(json_to)
    shown = {name: text for name, (_, text) in LABS.items() if name != "list"}
    width = max((len(name) for name in shown), default=0)
    for name, text in shown.items():
        out(f"{name:<{width}}  {text}")
    out.json([{"lab": name, "about": text} for name, text in shown.items()])
