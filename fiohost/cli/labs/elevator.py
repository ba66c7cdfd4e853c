"""``fiohost lab elevator``: the options of the elevator, and its keys."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from fiohost.cli.labs.present import present, report_folder, result_options
from fiohost.cli.options import parse_number, parse_seed, target_option, wire_options
from fiohost.cli.output import Output, output_for
from fiohost.cli.progress import progress
from fiohost.errors import ConfigError

if TYPE_CHECKING:
    from fiohost.bench.loop import Bench, Tick
    from fiohost.labs.elevator.experiment import Plan
    from fiohost.labs.result import LabResult

MOST_RUNS = 20  # of a list of gains


@click.command()
@target_option("sim:nxt_lego_elevator", "The bench with the car.")
@click.option(
    "--diagnose/--no-diagnose",
    "name_it",
    default=True,
    show_default=True,
    help="At the end, name what the model lacks beside the target.",
)
@click.option("--seed", metavar="N", help="How the shaft of a simulated board starts.")
@wire_options
@click.option("--gains", default="2,3,5", show_default=True, metavar="LIST", help="P gains, V/rad.")
@click.option("--ki", default="0.1,0.2,0.3", show_default=True, metavar="LIST", help="Integral gains, V/(rad s).")
@click.option("--ki-with", default="2", show_default=True, metavar="KP", help="The P gain beside them.")
@click.option("--powers", default="40,60,80", show_default=True, metavar="LIST", help="Power limits, %.")
@click.option("--powers-with", default="5", show_default=True, metavar="KP", help="The P gain beside them.")
@click.option("--kd", default="0.1,0.2,0.3", show_default=True, metavar="LIST", help="Derivative gains, V s/rad.")
@click.option("--kd-with", default="5", show_default=True, metavar="KP", help="The P gain beside them.")
@click.option("--ride-kp", default="5", show_default=True, metavar="KP", help="P gain of the ride by buttons.")
@click.option("--ride-ki", default="0", show_default=True, metavar="KI", help="Its integral gain.")
@click.option("--ride-power", default="40", show_default=True, metavar="PCT", help="Its power limit.")
@click.option("--presses", metavar="LIST", help="When buttons are held: up@1,up@3.5:0.7,down@9 (seconds:held).")
@click.option("--live", is_flag=True, help="Only the ride, by keys: u d one floor, U D two, q ends it.")
@click.option(
    "--current-limit",
    metavar="A",
    default="1",
    show_default=True,
    help="Current limit of model and target; none for none.",
)
@click.option(
    "--car-mass", default="0.124", show_default=True, metavar="KG", help="Of the car, for its constants by parts."
)
@click.option("--full-scale", default="4.5", show_default=True, metavar="V", help="The target's full duty in volts.")
@result_options
def elevator(
    target: str,
    name_it: bool,
    seed: str | None,
    gains: str,
    ki: str,
    ki_with: str,
    powers: str,
    powers_with: str,
    kd: str,
    kd_with: str,
    ride_kp: str,
    ride_ki: str,
    ride_power: str,
    presses: str | None,
    live: bool,
    current_limit: str,
    car_mass: str,
    full_scale: str,
    report: str | None,
    json_to: str | None,
) -> None:
    """Seven floors, a car that hangs on the drum: P, PI and limited power on model and target, then a ride by buttons.

    \b
    Example:
      fiohost lab elevator
      fiohost lab elevator --gains 2,4 --presses up@1,up@3:0.7,down@7 --json -
      fiohost lab elevator --live
    """
    if live and presses is not None:
        raise click.UsageError("--live takes its presses from the keys: leave --presses out")
    out = output_for(json_to)
    if live:
        from fiohost.panel.keys import has_keys

        if not has_keys(out.stream):
            raise ConfigError("--live reads keys, and this is no terminal: give --presses instead")

    from fiohost.bench.connect import connect
    from fiohost.labs.elevator.buttons import parse_presses
    from fiohost.labs.elevator.car import Design
    from fiohost.labs.elevator.experiment import DEFAULT_PRESSES, TEXT_LIMIT_A, Plan, experiment
    from fiohost.labs.elevator.parts import Parts

    ride = Design(
        parse_number("--ride-kp", ride_kp, 0.01, 1000.0, "V/rad"),
        parse_number("--ride-ki", ride_ki, 0.0, 1000.0, "V/(rad s)"),
        parse_number("--ride-power", ride_power, 1.0, 100.0, "%"),
    )
    plan = Plan(
        gains=_numbers("--gains", gains, 0.01, 1000.0),
        integral_gains=_numbers("--ki", ki, 0.001, 1000.0),
        integral_with=parse_number("--ki-with", ki_with, 0.01, 1000.0, "V/rad"),
        powers_pct=_numbers("--powers", powers, 1.0, 100.0),
        power_with=parse_number("--powers-with", powers_with, 0.01, 1000.0, "V/rad"),
        derivative_gains=_numbers("--kd", kd, 0.001, 100.0),
        derivative_with=parse_number("--kd-with", kd_with, 0.01, 1000.0, "V/rad"),
        ride=ride,
        presses=parse_presses(presses or DEFAULT_PRESSES),
        current_limit_A=None
        if current_limit == "none"
        else parse_number("--current-limit", current_limit, 0.05, 100.0),
        parts=Parts(car_kg=parse_number("--car-mass", car_mass, 0.0, 1.0, "kg")),
        full_scale_V=parse_number("--full-scale", full_scale, 0.5, 1000.0, "V"),
    )
    folder = report_folder(report)
    if live:
        with connect(target, seed=parse_seed(seed), realtime=True) as bench:
            result = _live(bench, plan, folder, out)
        present(result, out, folder)
        return
    with progress() as doing:
        with connect(target, seed=parse_seed(seed)) as bench:
            result = experiment(bench, plan, folder, doing)
        if name_it:
            from fiohost.labs.difference import with_difference
            from fiohost.labs.elevator.car import car_model

            limited = car_model(current_limit_A=plan.current_limit_A or TEXT_LIMIT_A)
            result = with_difference(result, car_model(), doing, limited=limited)
    present(result, out, folder)


def _numbers(option: str, text: str, low: float, high: float) -> tuple[float, ...]:
    """A list of different numbers, in the order given. Raises ConfigError."""
    found = tuple(dict.fromkeys(parse_number(option, part, low, high) for part in text.split(",")))
    if len(found) > MOST_RUNS:
        raise ConfigError(f"{option} holds {len(found)} numbers: at most {MOST_RUNS}")
    return found


def _live(bench: Bench, plan: Plan, folder: Path, out: Output) -> LabResult:
    """Keys become presses while the car moves."""
    from fiohost.labs.elevator.car import DEG_PER_CM, floor_cm
    from fiohost.labs.elevator.experiment import live
    from fiohost.labs.elevator.ride import ByKeys
    from fiohost.panel.keys import Keyboard

    out("u d or arrows: one floor; U D or shift with an arrow: held, two floors; q or Ctrl-C: brake and end")
    begin_deg: float | None = None

    def show(tick: Tick) -> None:
        nonlocal begin_deg
        begin_deg = tick.angle_deg if begin_deg is None else begin_deg
        height_cm = (tick.angle_deg - begin_deg) / DEG_PER_CM
        asked = f"asked for floor {demand.floor} ({floor_cm(demand.floor):g} cm)"
        line = f"\r{tick.time_s:6.1f} s  car at {height_cm:6.2f} cm, {asked}, duty {tick.command.duty_pct:6.1f} % "
        click.echo(line, nl=False, file=out.stream)

    with Keyboard() as keyboard:
        demand = ByKeys(keyboard.read)
        result = live(bench, plan, demand, folder, show)
    out()
    return result
