"""Options that several commands share, and the reading of their values.

Values come as text and are read here: a number out of range is a refusal (exit 1, a sentence), not a syntax error.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypeVar

import click

from fiohost.errors import ConfigError
from fiohost.files import entries

Command = TypeVar("Command", bound=Callable[..., Any])
# what of a folder is taken for logs and tables
TABLES = (".csv", ".tsv", ".txt", ".dat", ".mat", ".h5", ".hdf5", ".parquet")
PATH = click.Path(path_type=Path, readable=False)  # what cannot be read is refused by who reads it, with exit 1


def target_options(command: Command) -> Command:
    """Add ``--target`` and ``--seed``, as arguments ``target`` and ``seed`` (text or None), and the wire's options."""
    command = wire_options(command)
    seed_help = "For sim:sealed: which board. For other simulated boards: how the shaft starts."
    target_help = (
        "sim, sim:PLANT, sim:sealed, sim:sealed-faulty, hid, hid:SERIAL, serial:PORT, replay:FILE, "
        "emulated:BOARD[:PLANT], or a profile: its name or file, also with :REST."
    )
    priority_help = "Run before all ordinary programs, where the system allows it."
    command = click.option(
        "--realtime-priority", is_flag=True, expose_value=False, callback=_priority, help=priority_help
    )(command)
    command = click.option("--seed", metavar="N", help=seed_help)(command)
    return target_option("sim", target_help)(command)


def target_option(default: str, text: str) -> Callable[[Command], Command]:
    """Add ``--target`` with its default, and ``--student``, which stands for one; argument ``target``."""

    def add(command: Command) -> Command:
        command = click.option(
            "--student", metavar="ID", is_eager=True, expose_value=False, callback=_student,
            help="A sealed simulated board of that student's own, always the same one.",
        )(command)  # fmt: skip
        return click.option(
            "--target", default=default, show_default=True, metavar="T", help=text, callback=_target
        )(command)  # fmt: skip

    return add


def _student(ctx: click.Context, parameter: click.Parameter, value: str | None) -> None:
    if value is not None and not ctx.resilient_parsing:
        from fiohost.bench.seal import student_seed

        student_seed(value)  # refused here, before anything is opened
        ctx.meta["student"] = value


def _target(ctx: click.Context, parameter: click.Parameter, value: str) -> str:
    student = ctx.meta.get("student")
    if student is None:
        return value
    if value not in (parameter.default, "sim", "sim:sealed"):
        raise ConfigError(f"--student is a simulated board of its own: leave --target {value[:60]!r} away")
    return f"sim:student:{student}"


def wire_options(command: Command) -> Command:
    """Add ``--trace``, ``--limit``, ``--guard`` and ``--reconnect``, which every bench of the command then has; no
    arguments.
    """
    guard_help = "Change a guard of the target, such as gap_s or stall_s; may be repeated."
    command = click.option(
        "--guard", multiple=True, metavar="KEY=NUMBER", expose_value=False, callback=_guard, help=guard_help
    )(command)
    reconnect_help = "Wait S seconds for a board that went away in a run, to brake it as soon as it is back."
    command = click.option("--reconnect", metavar="S", expose_value=False, callback=_reconnect, help=reconnect_help)(
        command
    )
    trace_help = "Record all traffic with the target; replay:F plays it back."
    limit_help = "Stricter limit: duty_pct, slew_pct_per_s, travel_deg or run_time_s; may be repeated."
    command = click.option(
        "--limit", multiple=True, metavar="KEY=NUMBER", expose_value=False, callback=_limit, help=limit_help
    )(command)
    return click.option("--trace", metavar="F", expose_value=False, callback=_trace, help=trace_help)(command)


def _trace(ctx: click.Context, parameter: click.Parameter, value: str | None) -> None:
    if value is not None and not ctx.resilient_parsing:
        from fiohost.bench.connect import asking

        ctx.with_resource(asking(trace=value))


def _guard(ctx: click.Context, parameter: click.Parameter, value: Sequence[str]) -> None:
    if value and not ctx.resilient_parsing:
        from fiohost.bench.connect import asking
        from fiohost.transport.profile import Guards

        parts = [text.partition("=") for text in value]
        asked = {key.strip(): parse_number(f"--guard {key}", number, -1e9, 1e9) for key, _, number in parts}
        Guards().changed(asked)  # refused here, before anything is opened
        ctx.with_resource(asking(guards=asked))


def _priority(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        from fiohost.bench.priority import realtime_priority

        ctx.with_resource(realtime_priority())


def _limit(ctx: click.Context, parameter: click.Parameter, value: Sequence[str]) -> None:
    if value and not ctx.resilient_parsing:
        from fiohost.bench.connect import asking
        from fiohost.transport.profile import Limits

        parts = [text.partition("=") for text in value]
        asked = {key.strip(): parse_number(f"--limit {key}", number, -1e9, 1e9) for key, _, number in parts}
        Limits().within(asked)  # refused here, before anything is opened
        ctx.with_resource(asking(limits=asked))


def _reconnect(ctx: click.Context, parameter: click.Parameter, value: str | None) -> None:
    if value is not None and not ctx.resilient_parsing:
        from fiohost.bench.connect import asking

        ctx.with_resource(asking(reconnect_s=parse_number("--reconnect", value, 0.0, 86_400.0, "s")))


def profile_option(command: Command) -> Command:
    """Add ``--profile FILE``, a bench profile, as argument ``profile`` (text or None)."""
    text = "Bench profile with the deadband, from fiohost deadband --save."
    return click.option("--profile", metavar="FILE", help=text)(command)


def expanded(paths: Sequence[Path], what: str) -> list[Path]:
    """Files for files, folders (all tables and logs in them) and patterns such as ``run_*.csv``, in order of names.

    Raises ConfigError where a folder or pattern holds none.
    """
    found: list[Path] = []
    for path in paths:
        if os.path.isdir(path):  # pathlib's raises where a name is too long
            inside = [
                p for p in entries(path, "the folder", ConfigError) if p.suffix.lower() in TABLES and os.path.isfile(p)
            ]
            if not inside:
                raise ConfigError(f"{what} {path}: the folder holds no log or table ({', '.join(TABLES)})")
            found += inside
        elif any(mark in path.name for mark in "*?[") and not os.path.exists(path):
            inside = [p for p in entries(path.parent, "the folder", ConfigError) if fnmatchcase(p.name, path.name)]
            if not inside:
                raise ConfigError(f"{what} {path}: no file fits this pattern")
            found += inside
        else:
            found.append(path)
    return found


def parse_number(option: str, text: str, low: float, high: float, unit: str = "") -> float:
    """A finite number within [low, high]. Raises ConfigError naming the option."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        ending = f" {unit}" if unit else ""
        raise ConfigError(f"{option} {text[:60]!r} is not a number within {low:g} to {high:g}{ending}")
    return value


def parse_whole(option: str, text: str, low: int, high: int) -> int:
    """A whole number within [low, high]. Raises ConfigError naming the option."""
    try:
        value = int(text)
    except ValueError:
        value = low - 1
    if not low <= value <= high:
        raise ConfigError(f"{option} {text[:60]!r} is not a whole number within {low} to {high}")
    return value


def parse_seed(text: str | None) -> int | None:
    return None if text is None else parse_whole("--seed", text, 0, 2**63 - 1)


def parse_numbers(option: str, text: str, low: float, high: float, most: int = 20) -> tuple[float, ...]:
    """A list of different numbers with commas between, in the order given. Raises ConfigError."""
    found = tuple(dict.fromkeys(parse_number(option, part, low, high) for part in text.split(",")))
    if len(found) > most:
        raise ConfigError(f"{option} holds {len(found)} numbers: at most {most}")
    return found
