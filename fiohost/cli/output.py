"""What commands print: text on standard output, and with ``--json FILE|-`` the result as strict JSON.

With ``--json -`` standard output holds the JSON and nothing else; all text goes to standard error.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

import click

from fiohost import files, strict_json

if TYPE_CHECKING:
    from rich.console import Console

Command = TypeVar("Command", bound=Callable[..., Any])


def json_option(command: Command) -> Command:
    """Add ``--json FILE|-`` to a command, as its argument ``json_to``, and ``--force`` for all that it writes."""
    command = click.option(
        "--force", is_flag=True, is_eager=True, expose_value=False, callback=_force, help="Overwrite what exists."
    )(command)
    return click.option(
        "--json", "json_to", metavar="FILE|-", help="Write the result as JSON; with - to standard output."
    )(command)


def _force(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value and not ctx.resilient_parsing:
        ctx.with_resource(files.overwriting())


class Output:
    """Where a command's text goes. Calling it prints one line; ``json`` writes the result."""

    def __init__(self, json_to: str | None = None) -> None:
        self.json_to = json_to
        if json_to is not None and json_to != "-":
            files.claim(json_to)

    @property
    def stream(self) -> TextIO:
        return sys.stderr if self.json_to == "-" else sys.stdout

    @property
    def verbose(self) -> bool:
        """Whether -v was given."""
        return logging.getLogger("fiohost").isEnabledFor(logging.INFO)

    @property
    def is_terminal(self) -> bool:
        return self.stream.isatty()

    def __call__(self, text: str = "", *, styled: bool = False) -> None:
        """Print one line. *styled*: its colours are this program's own, and it holds no name of anybody else's."""
        lines = files.escaped(text, styled=styled).split("\n")
        click.echo("\n".join(map(files.shortened, lines)), file=self.stream)

    @property
    def console(self) -> Console:
        """A rich console on the same stream, for tables and live lines."""
        from rich.console import Console

        return Console(file=self.stream, highlight=False, soft_wrap=not self.is_terminal)

    def json(self, result: Any) -> None:
        """Write the result where ``--json`` says; without it nothing happens. Raises FiohostError."""
        write_json(self.json_to, result)


def output_for(json_to: str | None) -> Output:
    """The output of a command; a JSON file that cannot be written is refused here, before any work is done."""
    return Output(json_to)


def write_json(json_to: str | None, result: Any) -> None:
    """Write strict JSON (NaN and infinity become null) to a file, or to standard output for ``-``."""
    if json_to is None:
        return
    to_stream = json_to == "-"  # whose encoding is anybody's
    text = strict_json.text(result, ascii_only=to_stream)
    if to_stream:
        click.echo(text, nl=False)
        return
    files.write_output(json_to, text)
