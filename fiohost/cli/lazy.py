"""A group of commands each imported when it is used: help stands in the table, so listing imports nothing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from importlib import import_module

import click
from click.shell_completion import CompletionItem


class LazyCommands(click.Group):
    """A click group over a table: name -> (module:attribute, short help). A misspelled name gets suggestions."""

    table: Mapping[str, tuple[str, str]] = {}
    groups: Mapping[str, Sequence[str]] = {}  # title -> names, for the help

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.table)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.table:
            return None
        module, _, attribute = self.table[cmd_name][0].partition(":")
        command: click.Command = getattr(import_module(module), attribute)
        if ctx.resilient_parsing:  # a shell asks what may come next
            from fiohost.cli.complete import completed

            return completed(command)
        return command

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """The names of commands with their help, without importing them; options come from click."""
        found = [CompletionItem(n, help=text) for n, (_, text) in self.table.items() if n.startswith(incomplete)]
        return found or click.Command.shell_complete(self, ctx, incomplete)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0] if args else ""
        if name and not name.startswith("-") and name not in self.table and not ctx.resilient_parsing:
            close = get_close_matches(name, self.table, n=3, cutoff=0.5)
            hint = f"did you mean {' or '.join(repr(one) for one in close)}?" if close else "--help lists the commands."
            ctx.fail(f"No such command {name[:60]!r}; {hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        left = dict(self.table)
        for title, names in self.groups.items():
            rows = [(name, left.pop(name)[1]) for name in names if name in left]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)
        if left:
            with formatter.section("More" if self.groups else "Commands"):
                formatter.write_dl([(name, text) for name, (_, text) in left.items()])
