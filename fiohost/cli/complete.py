"""What a shell offers when the tab key is pressed: names of experiments, targets, effects, models, maps."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

import click
from click.shell_completion import CompletionItem

Items = list[CompletionItem]
Completer = Callable[[click.Context, click.Parameter, str], Items]


def experiments(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
    """Shipped experiments, and files."""
    return _files(incomplete) + _names("experiments", incomplete)


def models(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
    """``linear`` and its effects, plus by plus; shipped models; files."""
    from fiohost.motor.effect import effects as library

    head, plus, last = incomplete.rpartition("+")
    if plus:
        taken = set(head.split("+"))
        return [CompletionItem(f"{head}+{n}") for n in library() if n.startswith(last) and n not in taken]
    return _files(incomplete) + _matching(["linear"], incomplete) + _names("models", incomplete)


def maps(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
    """Shipped maps, and files."""
    return _files(incomplete) + _names("maps", incomplete)


def effects(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
    """The library's effects."""
    from fiohost.motor.effect import effects as library

    return _matching(library(), incomplete)


def targets(ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
    """Simulated boards with their plants, profiles, media, and serial ports that are there."""
    from fiohost.settings import config_names

    profiles = config_names("targets")
    medium, colon, rest = incomplete.partition(":")
    if not colon:
        return _matching(["sim", "sim:", "hid", "serial:", "replay:", "emulated:", *profiles], incomplete)
    if medium == "sim":
        from fiohost.transport.simulated import list_plants

        return _matching(
            [f"sim:{n}" for n in ("sealed", "sealed-faulty", *(one["name"] for one in list_plants()))], incomplete
        )
    if medium == "serial":
        from pathlib import Path

        ports = [str(p) for pattern in ("ttyACM*", "ttyUSB*", "cu.usb*") for p in sorted(Path("/dev").glob(pattern))]
        return _matching([f"serial:{port}" for port in ports], incomplete)
    return _files(rest) if medium == "replay" else []


# argument or option of any command -> what completes it
COMPLETERS = {
    "experiment": experiments,
    "target": targets,
    "model": models,
    "against": models,
    "table_map": maps,
    "what": effects,
}


def completed(command: click.Command) -> click.Command:
    """The command, its parameters completed by their names."""
    for parameter in command.params:
        known = COMPLETERS.get(parameter.name or "")
        if known is not None:
            offer = partial(_offer, known, parameter)
            setattr(parameter, "shell_complete", offer)  # noqa: B010 (a method of click's, in place of it)
    return command


def _offer(known: Completer, parameter: click.Parameter, ctx: click.Context, incomplete: str) -> Items:
    return known(ctx, parameter, incomplete)


def _names(kind: str, incomplete: str) -> Items:
    from fiohost.settings import config_names

    return _matching(config_names(kind), incomplete)


def _matching(names: Iterable[str], incomplete: str) -> Items:
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _files(incomplete: str) -> Items:
    """The shell's own list of files; it comes first, as bash forgets what stood before it."""
    return [CompletionItem(incomplete, type="file")]
