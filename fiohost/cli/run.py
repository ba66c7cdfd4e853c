"""``fiohost run``: a scripted experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from fiohost.cli.options import parse_seed, profile_option, target_options
from fiohost.cli.output import Output, json_option, output_for
from fiohost.errors import ConfigError

if TYPE_CHECKING:
    from fiohost.bench.experiment import Experiment
    from fiohost.bench.log import Log
    from fiohost.bench.loop import Tick

SCHEMA = "fiohost.run/1"


@click.command()
@click.argument("experiment", required=False)
@target_options
@click.option("--log", "log_to", metavar="F", help="The log to write; otherwise EXPERIMENT-DATE-TIME.csv here.")
@click.option("--controller", metavar="FILE", help="Controller file in place of the experiment's controller.")
@profile_option
@click.option("--realtime", is_flag=True, help="Keep real time on a simulated target too.")
@click.option("--list", "listing", is_flag=True, help="List the experiments that ship with fiohost.")
@json_option
def run(
    experiment: str | None,
    target: str,
    seed: str | None,
    log_to: str | None,
    controller: str | None,
    profile: str | None,
    realtime: bool,
    listing: bool,
    json_to: str | None,
) -> None:
    """Run EXPERIMENT, a shipped one by name or a TOML file, from rest; brake, and say what happened. A bench profile
    puts its own deadband compensation in the place of the experiment's or the controller file's.

    \b
    Example:
      fiohost run square_170_190 --log run.csv
      fiohost run my_staircase.toml --target sim:nxt_no_load
      fiohost run square_170_190 --controller pd.toml --profile bench.toml
    """
    from fiohost.bench.experiment import Experiment

    out = output_for(json_to)
    if listing:
        _list(out)
        return
    if experiment is None:
        raise click.UsageError("say which EXPERIMENT; --list shows those that ship with fiohost")
    plan = _with_control(Experiment.load(experiment), controller, profile)

    from datetime import datetime
    from pathlib import Path

    from fiohost.bench.connect import connect
    from fiohost.files import FreeName

    log_path: str | FreeName = log_to or FreeName(Path(f"{plan.name}-{datetime.now():%Y%m%d-%H%M%S}.csv"))
    with connect(target, seed=parse_seed(seed), realtime=realtime) as bench:
        loop = "closed loop" if plan.closed_loop else "open loop"
        out(f"{plan.name}: {plan.title or loop}; {loop}, {plan.duration_s:g} s on {bench.transport.name}")
        watch = _progress(out) if bench.clock.real else None
        log = bench.run(plan, log_path, progress=watch, progress_every_s=1.0)
        result = _result(plan, log, bench.transport.name) | {"tick_statistics": bench.statistics.as_dict()}
        _say(out, result, bench.statistics.describe())
    out.json(result)


def _with_control(plan: Experiment, controller: str | None, profile: str | None) -> Experiment:
    """The experiment with a controller file's law, and a bench profile's compensation. Raises ConfigError."""
    if controller is None and profile is None:
        return plan
    if plan.control is None:
        raise ConfigError(f"experiment {plan.name!r} is an open loop: --controller and --profile go with a closed one")

    from dataclasses import replace
    from pathlib import Path

    from fiohost.bench.profile import BenchProfile
    from fiohost.control.settings import ControlSettings

    control = plan.control if controller is None else ControlSettings.load(Path(controller))
    if profile is not None:
        control = control.with_compensation(*BenchProfile.load(profile).compensation_pct)
    return replace(plan, control=control)


def _progress(out: Output) -> Any:
    def line(tick: Tick) -> None:
        ref = "" if tick.ref_deg is None else f"  reference {tick.ref_deg:7.1f} deg"
        out(f"{tick.time_s:7.1f} s  duty {tick.command.duty_pct:6.1f} %{ref}  angle {tick.angle_deg:8.1f} deg")

    return line


def _result(plan: Experiment, log: Log, target: str) -> dict[str, Any]:
    import numpy as np

    speed = np.diff(log.output) / np.diff(log.time_s)
    result: dict[str, Any] = {
        "schema": SCHEMA,
        "experiment": plan.name,
        "target": target,
        "log": str(log.path),
        "sha256": log.sha256,
        "run_id": log.metadata.get("run_id"),
        "rows": len(log),
        "seconds": float(log.time_s[-1] - log.time_s[0] + log.sample_time_s),
        "duty_pct": [float(log.duty_pct.min()), float(log.duty_pct.max())],
        "angle_deg": [float(log.output.min()), float(log.output.max())],
        "fastest_deg_s": float(np.abs(_smooth(speed)).max()) if speed.size else 0.0,
        "command_delay_ticks": log.command_delay_ticks,
        "notes": list(log.dropped),
    }
    if plan.control is not None:
        error = log.columns["ref_deg"] - log.output
        last = log.time_s >= log.time_s[-1] / 2
        result["error_rms_second_half_deg"] = float(np.sqrt(np.mean(error[last] ** 2)))
        result["saturated_share"] = float(np.mean(np.abs(log.duty_pct) >= plan.control.limit_pct))
    return result


def _smooth(values: Any, width: int = 10) -> Any:
    """Mean over *width* ticks: a single count is 100 deg/s at 5 ms."""
    import numpy as np

    return np.convolve(values, np.full(min(width, values.size), 1.0 / min(width, values.size)), mode="valid")


def _say(out: Output, result: dict[str, Any], statistics: str) -> None:
    duty, angle = result["duty_pct"], result["angle_deg"]
    out(f"duty {duty[0]:.4g} .. {duty[1]:.4g} %, angle {angle[0]:.1f} .. {angle[1]:.1f} deg, "
        f"fastest {result['fastest_deg_s']:.0f} deg/s")  # fmt: skip
    if "error_rms_second_half_deg" in result:
        out(f"error against the reference, second half: {result['error_rms_second_half_deg']:.3g} deg rms; "
            f"duty at its limit in {100 * result['saturated_share']:.1f} % of the ticks")  # fmt: skip
    out(f"{statistics}; {result['rows']} rows in {result['log']}; braked")
    for note in result["notes"]:
        out(f"note: {note}")


def _list(out: Output) -> None:
    from fiohost.bench.experiment import Experiment

    plans = [Experiment.load(name) for name in Experiment.names()]
    for plan in plans:
        out(f"{plan.name:<18s} {'closed' if plan.closed_loop else 'open  '} {plan.duration_s:6g} s  {plan.title}")
    out.json(
        {
            "schema": "fiohost.experiments/1",
            "experiments": [
                {"name": p.name, "title": p.title, "closed_loop": p.closed_loop, "duration_s": p.duration_s}
                for p in plans
            ],
        }
    )
