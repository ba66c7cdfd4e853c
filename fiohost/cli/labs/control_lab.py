"""``fiohost lab``: the control lab's experiments 1 to 5 and the checklist of its steps; their options."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from fiohost.cli.labs.present import present, report_folder, result_options
from fiohost.cli.options import parse_number, parse_numbers, parse_seed, target_option, wire_options
from fiohost.cli.output import output_for
from fiohost.cli.progress import progress
from fiohost.errors import ConfigError

if TYPE_CHECKING:
    from fiohost.labs.play import Torque
    from fiohost.labs.result import LabResult
    from fiohost.labs.session import Session

Command = TypeVar("Command", bound=Callable[..., Any])
MOST_TORQUE_NM = 10.0


def bench_options(target: str, constants: str, saturation: str = "both") -> Callable[[Command], Command]:
    """Add the options of every experiment: where it is done, with which constants, limits and output."""

    def add(command: Command) -> Command:
        limits_help = "both, voltage (4.5 V), current (1 A), half (2.25 V, 1 A) or none."
        for option in (
            click.option("--diagnose/--no-diagnose", "name_it", default=True, show_default=True,
                         help="At the end, name what the model lacks beside the target."),
            click.option("--animate", is_flag=True, help="Also a moving picture (GIF)."),
            click.option("--saturation", default=saturation, show_default=True, metavar="LIMITS", help=limits_help),
            click.option("--constants", default=constants, show_default=True, metavar="SET|FILE",
                         help="The motor's constants: no_load, arm_measured, arm_tuned, elevator, or a file."),
            click.option("--seed", metavar="N", help="How the shaft of a simulated board starts."),
            target_option(target, "The bench; without it, another set of --constants has its own."),
        ):  # fmt: skip
            command = option(command)
        return result_options(wire_options(command))

    return add


def disturbance_options(torque: str, at: str) -> Callable[[Command], Command]:
    def add(command: Command) -> Command:
        text = "Torque on the shaft, positive forward; 0 for none."
        command = click.option("--disturbance-at", default=at, show_default=True, metavar="S", help="When it comes.")(
            command
        )
        return click.option("--disturbance", default=torque, show_default=True, metavar="NM", help=text)(command)

    return add


def _torque(disturbance: str, at: str) -> Torque | None:
    from fiohost.labs.play import Torque

    torque_Nm = parse_number("--disturbance", disturbance, -MOST_TORQUE_NM, MOST_TORQUE_NM, "N m")
    at_s = parse_number("--disturbance-at", at, 0.1, 60.0, "s")
    return Torque(torque_Nm, at_s) if torque_Nm else None


def _do(options: dict[str, Any], experiment: Callable[[Session], LabResult]) -> None:
    """Open the bench, do the experiment, show what it gave."""
    from fiohost.labs.session import BENCHES, Session

    out = output_for(options["json_to"])
    context, target = click.get_current_context(), options["target"]
    if context.get_parameter_source("target") is ParameterSource.DEFAULT and "student" not in context.meta:
        target = BENCHES.get(options["constants"], target)
    folder = report_folder(options["report"])
    seed = parse_seed(options["seed"])
    with progress() as doing:
        with Session.open(
            target, options["constants"], folder, seed=seed, saturation=options["saturation"], said=doing
        ) as session:
            result = experiment(session)
            if options["name_it"]:
                from fiohost.labs.small import with_small_steps

                result, model, limited = with_small_steps(session, result)
        if options["name_it"]:
            from fiohost.labs.difference import with_difference

            result = with_difference(result, model, doing, limited=limited)
    present(result, out, folder)


@click.command("open-loop-step")
@click.option("--volts", default="1,3,-2", show_default=True, metavar="LIST", help="Steps of voltage.")
@disturbance_options("-0.05", "2")
@bench_options("sim:nxt_lego", "no_load")
def open_loop_step(volts: str, disturbance: str, disturbance_at: str, animate: bool, **options: Any) -> None:
    """Steps of voltage: speed, time constant, friction and inertia from it, on model and target (steps 1 to 8).

    \b
    Example:
      fiohost lab open-loop-step --volts 1,3,-2 --disturbance -0.05
    """
    levels = parse_numbers("--volts", volts, -100.0, 100.0)
    if 0.0 in levels:
        raise ConfigError("--volts holds a 0: a step of nothing shows nothing")
    torque = _torque(disturbance, disturbance_at)
    from fiohost.labs.open_loop_step import open_loop_step as experiment

    _do(options, lambda session: experiment(session, levels, torque, animate))


@click.command("open-loop-sine")
@click.option("--frequencies", default="0.5,1,2,5,10,20,40", show_default=True, metavar="LIST", help="In rad/s.")
@click.option("--small", default="2", show_default=True, metavar="V", help="Amplitude that does not saturate.")
@click.option("--large", default="10", show_default=True, metavar="V", help="Amplitude that does.")
@click.option("--log", "log_from", metavar="F", help="Only the gain and phase calculator, on this log.")
@click.option("--frequency", metavar="RAD_S", help="The calculator's frequency.")
@bench_options("sim:nxt_lego", "no_load")
def open_loop_sine(
    frequencies: str, small: str, large: str, log_from: str | None, frequency: str | None, animate: bool, **options: Any
) -> None:
    """Sines of voltage: gain, phase and Bode plot, and what saturation does (steps 9 and 10); or --log, a calculator.

    \b
    Example:
      fiohost lab open-loop-sine
      fiohost lab open-loop-sine --log lab/sine_2V_1rad_s.csv --frequency 1
    """
    from fiohost.labs.open_loop_sine import calculator
    from fiohost.labs.open_loop_sine import open_loop_sine as experiment

    if log_from is not None:
        if frequency is None:
            raise click.UsageError("--log wants --frequency, in rad/s")
        from fiohost.bench.log import Log
        from fiohost.labs.constants import MotorConstants

        out, folder = output_for(options["json_to"]), report_folder(options["report"])
        log, q = Log.read(log_from), MotorConstants.load(options["constants"])
        supply = parse_number("supply_V of the log", log.metadata.get("supply_V") or str(q.supply_V), 0.1, 1e3, "V")
        omega = parse_number("--frequency", frequency, 0.01, 1000.0, "rad/s")
        present(calculator(log, omega, q, supply), out, folder)
        return
    if animate:
        raise ConfigError("--animate belongs to the other experiments: a sine has its plot in time")
    at = parse_numbers("--frequencies", frequencies, 0.01, 200.0)
    levels = [parse_number(name, text, 0.01, 1000.0, "V") for name, text in (("--small", small), ("--large", large))]
    _do(options, lambda session: experiment(session, sorted(at), *levels))


@click.command("speed-control")
@click.option("--gains", default="0.1,0.5,1", show_default=True, metavar="LIST", help="P gains, V per rad/s.")
@click.option("--refs", default="12,-10,15", show_default=True, metavar="LIST", help="Steps of speed, rad/s.")
@click.option("--gear-load", default="0.5", show_default=True, metavar="KGM2", help="Inertia behind the 1:24 gear.")
@disturbance_options("-0.05", "1")
@bench_options("sim:nxt_lego", "no_load")
def speed_control(
    gains: str, refs: str, gear_load: str, disturbance: str, disturbance_at: str, animate: bool, **options: Any
) -> None:
    """Proportional speed control, a gear head, a disturbance under P and PI (steps 11 to 15).

    \b
    Example:
      fiohost lab speed-control --gains 0.1,0.5,1 --refs 12,-10,15
    """
    kps = parse_numbers("--gains", gains, 1e-4, 1000.0)
    speeds = parse_numbers("--refs", refs, -1000.0, 1000.0)
    if 0.0 in speeds:
        raise ConfigError("--refs holds a 0: a step of nothing shows nothing")
    load = parse_number("--gear-load", gear_load, 0.0, 1e6, "kg m2")
    torque = _torque(disturbance, disturbance_at)
    from fiohost.labs.speed_control import speed_control as experiment

    _do(options, lambda session: experiment(session, kps, speeds, torque, load, animate))


@click.command("position-control")
@click.option("--step", "step_deg", default="160", show_default=True, metavar="DEG", help="Step of the reference.")
@click.option("--gains", default="1.5,2,5", show_default=True, metavar="LIST", help="P gains, V/rad.")
@click.option("--integral-with", default="2", show_default=True, metavar="KP", help="P gain beside the integrals.")
@click.option("--integrals", default="1,3,6", show_default=True, metavar="LIST", help="Integral gains, V/(rad s).")
@click.option("--pid", default="3,6,0.1", show_default=True, metavar="P,I,D", help="A PID, V/rad, V/(rad s), V s/rad.")
@click.option("--overshoot", default="30", show_default=True, metavar="PCT", help="Of the PI to be designed.")
@click.option("--rise", default="0.1", show_default=True, metavar="S", help="Of the PI to be designed.")
@disturbance_options("-0.1", "2")
@bench_options("sim:nxt_lego", "no_load")
def position_control(
    step_deg: str, gains: str, integral_with: str, integrals: str, pid: str, overshoot: str, rise: str,
    disturbance: str, disturbance_at: str, animate: bool, **options: Any,
) -> None:  # fmt: skip
    """P, PI and PID position control, a disturbance, saturation, and a PI designed (steps 16 to 25).

    \b
    Example:
      fiohost lab position-control --gains 1.5,2,5 --disturbance -0.1
    """
    from fiohost.labs.position_control import PositionPlan
    from fiohost.labs.position_control import position_control as experiment

    step = parse_number("--step", step_deg, -100_000.0, 100_000.0, "deg")
    if abs(step) < 1.0:
        raise ConfigError(f"--step {step:g}: a step of less than a degree is lost in the encoder's counts")
    plan = PositionPlan(
        step_deg=step,
        gains=parse_numbers("--gains", gains, 0.01, 1000.0),
        integral_with=parse_number("--integral-with", integral_with, 0.01, 1000.0, "V/rad"),
        integrals=parse_numbers("--integrals", integrals, 0.001, 1000.0),
        pid=_gains("--pid", pid),
        torque=_torque(disturbance, disturbance_at),
        overshoot_pct=parse_number("--overshoot", overshoot, 5.0, 90.0, "percent"),
        rise_s=parse_number("--rise", rise, 0.005, 5.0, "s"),
        animate=animate,
    )
    _do(options, lambda session: experiment(session, plan))


@click.command("fine-tuning")
@click.option("--kp", default="3", show_default=True, metavar="KP", help="P gain, V/rad.")
@click.option("--step", "step_deg", default="160", show_default=True, metavar="DEG", help="Step of the reference.")
@click.option("--tune", default="J", show_default=True, metavar="J|B|both", help="What is tuned.")
@click.option("--save", "save_to", metavar="F", help="Write the tuned constants for the other experiments.")
@bench_options("sim:nxt_lego_arm", "arm_measured", saturation="half")
def fine_tuning(kp: str, step_deg: str, tune: str, save_to: str | None, animate: bool, **options: Any) -> None:
    """Tune the inertia (or the friction) until the model's position response is the target's (section D-1-6).

    \b
    Example:
      fiohost lab fine-tuning --save arm.toml
      fiohost lab fine-tuning --tune both --kp 5
    """
    from dataclasses import replace
    from pathlib import Path

    from fiohost.files import claim
    from fiohost.labs.constants import MotorConstants
    from fiohost.labs.fine_tuning import fine_tuning as experiment

    if animate:
        raise ConfigError("--animate belongs to the other experiments")
    gain = parse_number("--kp", kp, 0.01, 1000.0, "V/rad")
    step = parse_number("--step", step_deg, -100_000.0, 100_000.0, "deg")
    if abs(step) < 1.0:
        raise ConfigError(f"--step {step:g}: a step of less than a degree is lost in the encoder's counts")
    if save_to is not None:
        claim(save_to)

    def tuned(session: Session) -> LabResult:
        found = experiment(session, gain, step, tune)
        if save_to is not None:
            source = f"{session.constants.source}, tuned by {session.target}"
            MotorConstants(**found.values["constants"], source=source).write(Path(save_to))
            found = replace(found, files={**found.files, "constants": save_to})
        return found

    _do(options, tuned)


@click.command("design-project")
@click.option("--angle", default="60", show_default=True, metavar="DEG", help="Where the cup stands, -90 to 90.")
@click.option("--gains", metavar="P,I,D", help="A controller of your own; without it one is searched for.")
@click.option("--wait", default="0", show_default=True, metavar="S", help="Let go no sooner than this.")
@click.option("--release", default="1", show_default=True, metavar="DEG", help="Let go within this of the cup.")
@click.option("--arm", default="0.12", show_default=True, metavar="M", help="Length of the arm.")
@click.option("--height", default="0.1", show_default=True, metavar="M", help="Height of the drop.")
@click.option("--payload", default="0.015", show_default=True, metavar="KG", help="Mass of the payload.")
@click.option("--cup", default="0.025", show_default=True, metavar="M", help="Radius of the cup.")
@bench_options("sim:nxt_lego_arm", "arm_measured")
def design_project(
    angle: str, gains: str | None, wait: str, release: str, arm: str, height: str, payload: str, cup: str,
    animate: bool, **options: Any,
) -> None:  # fmt: skip
    """The robotic arm: turn, let the payload go, hit the cup, fast.

    \b
    Example:
      fiohost lab design-project --angle 60 --animate
    """
    from fiohost.labs.design_project import Task
    from fiohost.labs.design_project import design_project as experiment

    task = Task(
        angle_deg=parse_number("--angle", angle, -90.0, 90.0, "deg"),
        wait_s=parse_number("--wait", wait, 0.0, 2.0, "s"),
        release_deg=parse_number("--release", release, 0.25, 30.0, "deg"),
        arm_m=parse_number("--arm", arm, 0.01, 2.0, "m"),
        height_m=parse_number("--height", height, 0.001, 5.0, "m"),
        payload_kg=parse_number("--payload", payload, 0.0, 5.0, "kg"),
        cup_radius_m=parse_number("--cup", cup, 0.001, 1.0, "m"),
    )
    chosen = None if gains is None else _gains("--gains", gains)
    _do(options, lambda session: experiment(session, task, chosen, animate))


@click.command("steps")
@click.option("--only", metavar="LIST", help="Some steps by number, as 16,21,25.")
@bench_options("sim:nxt_lego", "no_load")
def steps(only: str | None, animate: bool, **options: Any) -> None:
    """The text's steps 1 to 25: the command of each, and its answer by this run.

    \b
    Example:
      fiohost lab steps
      fiohost lab steps --only 16,21,25
    """
    from fiohost.labs.steps import LAST
    from fiohost.labs.steps import steps as experiment

    if animate:
        raise ConfigError("--animate belongs to the single experiments")
    wanted = [] if only is None else [round(n) for n in parse_numbers("--only", only, 1, LAST, most=LAST)]
    _do(options, lambda session: experiment(session, wanted))


def _gains(option: str, text: str) -> Any:
    from fiohost.labs.session import Gains

    parts = [parse_number(option, part, 0.0, 1000.0) for part in text.split(",")]
    if not 1 <= len(parts) <= 3 or parts[0] <= 0.0:
        raise ConfigError(f"{option} {text[:60]!r} is not P, or P,I or P,I,D with P above 0")
    return Gains(*parts)
