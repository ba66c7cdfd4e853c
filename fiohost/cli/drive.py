"""``fiohost manual``: one duty, held or changed by keys, until Ctrl-C or for some seconds, and what the shaft does."""

from __future__ import annotations

import select
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TextIO

import click

from fiohost.cli.options import parse_number, parse_seed, target_options
from fiohost.cli.output import Output, json_option, output_for
from fiohost.errors import ConfigError, FiohostError

if TYPE_CHECKING:
    from collections.abc import Callable

    from fiohost.bench.log import Log
    from fiohost.bench.loop import Bench, Tick

SCHEMA = "fiohost.manual/1"
LIVE_S = 0.1  # between two pictures of the live line
HEAD = "   time     duty  C3 C4  mode      POS     angle  direction      speed"


@click.command()
@click.option("--pwm", metavar="PCT", help="Signed duty in percent of full scale, -100 to 100; 0 brakes.")
@click.option("--standby", is_flag=True, help="Let the motor coast (C3 C4 = 0 0) instead of driving it.")
@click.option("--duration", metavar="S", help="Stop after S seconds; without it at Ctrl-C.")
@target_options
@click.option("--log", "log_to", metavar="F", help="Write every tick to this log.")
@json_option
@click.option("--fast", is_flag=True, help="Do not keep real time on a simulated target (needs --duration).")
def manual(
    pwm: str | None,
    standby: bool,
    duration: str | None,
    target: str,
    seed: str | None,
    log_to: str | None,
    json_to: str | None,
    fast: bool,
) -> None:
    """Drive until Ctrl-C or for S seconds, then brake; in a terminal the keys change the duty.

    Shows each second (in a terminal all the time) the duty sent, the direction bits C3 and C4, the encoder count POS,
    the angle by the lab's formula (POS+1)/2, the direction bit and the speed. Forward is 1 0, reverse 0 1, brake 1 1,
    standby 0 0. Keys: up and down 1 %, with shift or page up and down 10 %, space brakes, s standby, r reverses the
    sign, h help, q quits. In a terminal --pwm may be left out: it begins braked.

    \b
    Example:
      fiohost manual
      fiohost manual --pwm 40
      fiohost manual --pwm -25 --duration 5 --log reverse.csv
    """
    from fiohost.panel.keys import has_keys

    out = output_for(json_to)
    keys = not fast and has_keys(out.stream)
    if (pwm is None) != standby and not (keys and not standby):
        raise click.UsageError("give --pwm PCT or --standby, one of them")
    duty_pct = 0.0 if pwm is None else parse_number("--pwm", pwm, -100.0, 100.0, "percent of full scale")
    duration_s = None if duration is None else parse_number("--duration", duration, 0.005, 86_400.0, "s")
    if fast and duration_s is None:
        raise ConfigError("--fast without --duration would never end: say for how many seconds")

    from fiohost.bench.connect import connect
    from fiohost.bench.stop import Stopped

    with connect(target, seed=parse_seed(seed), realtime=not fast) as bench:
        view = _View(out, bench.counts_per_rev)
        ended = "complete"
        out(f"{bench.transport.name}: {'standby' if standby else f'duty {duty_pct:g} %'}; Ctrl-C brakes and ends")
        try:
            if keys:
                _drive_by_keys(bench, view, duty_pct, duration_s, log_to, standby=standby)
            else:
                with view:
                    log = bench.drive(
                        duty_pct, duration_s, log_to, standby=standby, progress=view, progress_every_s=view.every_s
                    )
                    view.last_row(log)
            out("braked (C3 C4 = 1 1)" + (f"; log: {log_to}" if log_to else ""))
        except Stopped as exc:
            ended = str(exc)
            raise
        finally:
            if view.samples:
                result = {"schema": SCHEMA, "target": bench.transport.name, "ended": ended, "log": log_to}
                out.json(result | {"samples": view.samples, "tick_statistics": bench.statistics.as_dict()})


def _drive_by_keys(
    bench: Bench, view: _View, duty_pct: float, duration_s: float | None, log_to: str | None, *, standby: bool
) -> None:
    from fiohost.panel.keys import HELP, Keyboard, KeyProgram
    from fiohost.wire.messages import STANDBY_COMMAND, Command

    command = STANDBY_COMMAND if standby else Command.drive(duty_pct)
    ticks = None if duration_s is None else max(1, round(duration_s / bench.sample_time_s))
    with Keyboard() as keyboard, view:
        program = KeyProgram(keyboard, command, bench.profile.limit_duty_pct, ticks)
        view.help = lambda: HELP if program.shows_help else ""
        bench.live(program, log_to, {"experiment": "manual", "loop": "open"}, view, view.every_s)


@dataclass
class _View(AbstractContextManager["_View"]):
    """Turns ticks into lines, one a second, or into a live line on a terminal, and keeps one sample a second."""

    out: Output
    counts_per_rev: int
    samples: list[dict[str, Any]] = field(default_factory=list)
    help: Callable[[], str] = str  # a line to stand below the live one
    _last: Tick | None = None
    _line: str = ""
    _live: Any = None

    @property
    def every_s(self) -> float:
        return LIVE_S if self.out.is_terminal else 1.0

    def __enter__(self) -> _View:
        self.out(HEAD)
        if self.out.is_terminal:
            from rich.live import Live

            self._live = Live(console=self.out.console, auto_refresh=False)
        (self._live or nullcontext()).__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        with suppress(OSError):  # the terminal may have gone
            (self._live or nullcontext()).__exit__(None, None, None)

    def __call__(self, tick: Tick) -> None:
        before, self._last = self._last, tick
        speed = (tick.angle_deg - before.angle_deg) / (tick.time_s - before.time_s) if before else 0.0
        self._show(tick, speed, keep=abs(tick.time_s - round(tick.time_s)) < 1e-6)

    def last_row(self, log: Log) -> None:
        """Show how it ended, with the speed over the last second."""
        from fiohost.bench.loop import Tick

        if self._last is None or log.time_s[-1] <= self._last.time_s:
            return
        back = max(0, len(log) - 1 - round(1.0 / log.sample_time_s))
        span_s = float(log.time_s[-1] - log.time_s[back])
        speed = float(log.output[-1] - log.output[back]) / span_s if span_s else 0.0
        pos, direction = int(log.columns["pos"][-1]), int(log.columns["direction"][-1])
        tick = Tick(float(log.time_s[-1]), self._last.command, pos, direction, float(log.output[-1]), None)
        self._show(tick, speed, keep=True)

    def _show(self, tick: Tick, speed: float, *, keep: bool) -> None:
        command = tick.command
        angle = (tick.pos + 1) * 360.0 / self.counts_per_rev
        turning = "1 (down)" if tick.direction else "0 (up)"
        self._line = (
            f"{tick.time_s:7.2f} s {command.duty_pct:6.1f}%   {command.c3}  {command.c4}  {command.mode_name:<7s} "
            f"{tick.pos:5d}  {angle:6.1f} deg  {turning:<9s} {speed:7.1f} deg/s"
        )
        if keep:
            self.samples.append(
                {
                    "time_s": tick.time_s,
                    "duty_pct": command.duty_pct,
                    "c3": command.c3,
                    "c4": command.c4,
                    "mode": command.mode_name,
                    "pos": tick.pos,
                    "angle_display_deg": angle,
                    "angle_deg": tick.angle_deg,
                    "direction": tick.direction,
                    "speed_deg_s": speed,
                }
            )
        if self._live is not None:
            from rich.text import Text

            if not self.out.is_terminal:  # any more: rich would say nothing, for ever
                raise FiohostError("the terminal has gone; the motor was braked")
            if _takes_text(self.out.stream):
                self._live.update(Text("\n".join(filter(None, (self._line, self.help()))), no_wrap=True), refresh=True)
        else:
            self.out(self._line)


def _takes_text(stream: TextIO) -> bool:
    """Whether a terminal takes text now: one that is held or hung must not hold up the tick loop."""
    try:
        return bool(select.select([], [stream], [], 0.0)[1])
    except (OSError, ValueError):  # Windows knows this of sockets only
        return True
