"""``fiohost watch``: when a motor stops behaving like its model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fiohost.cli.options import PATH, parse_number, parse_seed, parse_whole, target_options
from fiohost.cli.output import Output, json_option, output_for
from fiohost.errors import ConfigError

if TYPE_CHECKING:
    from fiohost.bench.experiment import Experiment
    from fiohost.bench.log import Log
    from fiohost.motor.model import Model
    from fiohost.watch.detector import Event


@click.command()
@click.argument("log", required=False, type=PATH, metavar="[LOG]")
@target_options
@click.option(
    "--model",
    default="linear+coulomb_friction",
    show_default=True,
    metavar="M",
    help="A model file (from diagnose --save-model), or an expression that is fitted to normal running.",
)
@click.option("--normal", type=PATH, metavar="LOG", help="A log of normal running to learn from.")
@click.option(
    "--learn",
    default="30",
    show_default=True,
    metavar="S",
    help="Without --normal the first S seconds are taken for normal.",
)
@click.option(
    "--idle",
    default="10",
    show_default=True,
    metavar="S",
    help="End when a log that its writer has not ended has not grown for S seconds; 0: at its end.",
)
@click.option("--experiment", default="soak", show_default=True, metavar="E", help="What a --target is driven with.")
@click.option("--times", default="1", show_default=True, metavar="N", help="Run the experiment N times in one log.")
@click.option("--log", "log_to", metavar="F", help="The log of a --target; otherwise EXPERIMENT-DATE-TIME.csv here.")
@click.option("--realtime", is_flag=True, help="Keep real time on a simulated target too.")
@click.option("--until-alarm", is_flag=True, help="End with the first alarm, named; a target is braked.")
@json_option
@click.pass_context
def watch(
    ctx: click.Context, log: Path | None, target: str, seed: str | None, model: str, normal: Path | None, learn: str,
    idle: str, experiment: str, times: str, log_to: str | None, realtime: bool, until_alarm: bool, json_to: str | None,
) -> None:  # fmt: skip
    """Follow a growing LOG, or drive a bench, and say within seconds when the motor stops behaving like its model:
    which effect, since when, how sure. For condition monitoring, not for safety.

    \b
    Examples:
      fiohost watch run.csv --model motor.toml
      fiohost watch run.csv --normal yesterday.csv --model motor.toml --json -
      fiohost watch --target serial:/dev/ttyACM0 --experiment soak --times 20 --model motor.toml
    """
    driven = ctx.get_parameter_source("target") == click.core.ParameterSource.COMMANDLINE
    if (log is not None) == driven:
        raise click.UsageError("give a LOG or --target T, one of them")
    learn_s, idle_s = parse_number("--learn", learn, 8.0, 3600.0, "s"), parse_number("--idle", idle, 0.0, 1e6, "s")
    count = parse_whole("--times", times, 1, 10_000)

    from fiohost.bench.experiment import Experiment
    from fiohost.bench.log import Log
    from fiohost.motor.model import Model

    out, declared = output_for(json_to), Model.parse(model)
    usual = Log.read(normal) if normal is not None else None
    if log is not None:
        _watch_log(out, log, declared, learn_s, usual, idle_s, until_alarm)
        return
    plan = _repeated(Experiment.load(experiment), count)
    _watch_bench(out, target, seed, plan, log_to, realtime, declared, learn_s, usual, until_alarm)


def _repeated(plan: Experiment, count: int) -> Experiment:
    from dataclasses import replace

    return replace(plan, command=tuple(plan.command) * count, reference=tuple(plan.reference) * count)


def _watch_log(
    out: Output, path: Path, model: Model, learn_s: float, normal: Log | None, idle_s: float, until_alarm: bool
) -> None:
    from fiohost.watch.follow import GrowingLog, following
    from fiohost.watch.watcher import Watch

    growing = GrowingLog(path)
    watch = Watch(model, growing.log, learn_s, [normal] if normal is not None else [], say=out)
    ended = "the log ended"
    try:
        for rows in following(growing, idle_s=idle_s, follow=idle_s > 0.0):
            for event in watch.take(rows):
                out(told(event))
            if until_alarm and any(e.kind == "named" for e in watch.events):
                ended = "alarm"
                break
        else:
            why = "the log was cut" if growing.cut_off else "the log grew no more"
            ended = "the log ended" if growing.ended else why
        if watch.learned is None:
            watch.finish_learning()
    except KeyboardInterrupt:
        out.json(watch.to_json("stopped"))
        raise
    finally:
        growing.close()
    _finish(out, watch.to_json(ended))


class _Enough(Exception):
    """The alarm that was waited for."""


def _watch_bench(
    out: Output, target: str, seed: str | None, plan: Experiment, log_to: str | None, realtime: bool, model: Model,
    learn_s: float, normal: Log | None, until_alarm: bool,
) -> None:  # fmt: skip
    from datetime import datetime

    from fiohost.bench.connect import connect
    from fiohost.files import claim
    from fiohost.watch.apart import WatchApart
    from fiohost.watch.detector import Event

    path = Path(log_to or f"{plan.name}-{datetime.now():%Y%m%d-%H%M%S}.csv")
    claim(path)
    apart: WatchApart | None = None

    def hear(tick: object) -> None:
        nonlocal apart
        if apart is None:  # the log is there by now
            apart = WatchApart(path, model, learn_s, normal)
        for said in apart.heard():
            out(told(said) if isinstance(said, Event) else said)
            if until_alarm and isinstance(said, Event) and said.kind == "named":
                raise _Enough

    ended = "the run ended"
    try:
        with connect(target, seed=parse_seed(seed), realtime=realtime) as bench:
            out(f"{plan.name}: {plan.duration_s:g} s on {bench.transport.name}; Ctrl-C brakes and ends; log: {path}")
            try:
                bench.run(plan, path, progress=hear, progress_every_s=1.0)
            except _Enough:
                ended = "alarm"
    except BaseException:
        if apart is not None:
            apart.stop()
        raise
    assert apart is not None
    for said in apart.end():
        if isinstance(said, dict):
            _finish(out, said | {"ended": ended, "log": str(path)})
        else:
            out(told(said) if isinstance(said, Event) else str(said))


def told(event: Event) -> str:
    """An event as a sentence or two."""
    if event.kind == "over":
        return f"{event.time_s:9.1f} s  the motor behaves like its model again"
    causes = ", ".join(
        f"{c.effect}{f' ({c.what})' if c.what else ''} {100 * c.share:.0f} % ({c.size:+.3g} {c.unit}, 95 % "
        f"{c.ci95[0]:+.3g} to {c.ci95[1]:+.3g})"
        for c in event.causes
    )
    causes = causes or "no effect of the library explains it"
    if event.kind == "drifted":
        return f"{event.time_s:9.1f} s  DRIFTED far from what was learned: {causes}"
    low, high = event.since_ci95_s
    since = f"since {event.since_s:.0f} s ({low:.0f} to {high:.0f})"
    if event.kind == "named":
        return f"{event.time_s:9.1f} s  named: {causes}; {since}"
    sure = f"chance alone would say so {event.false_alarms_per_day:.1g} times a day"
    head = f"{event.time_s:9.1f} s  ALARM: the motor does not behave like its model"
    return f"{head} {since}; {sure}; first guess: {causes}"


def _finish(out: Output, result: dict[str, Any]) -> None:
    if result["threshold"] is None:
        raise ConfigError("the log ended while normal running was being learned: nothing was judged; use --normal")
    alarms = result["alarms"]
    what = "no alarm" if not alarms else f"{alarms} alarm{'s' if alarms > 1 else ''}"
    out(f"{result['ended']}: {what} in {result['windows']} windows of one second, the last at {result['last_s']:.1f} s")
    out.json(result)
