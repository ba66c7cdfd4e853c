"""Options that say what a foreign table is, for every command that reads logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any, TypeVar

import click

from fiohost.cli.options import parse_number
from fiohost.errors import ConfigError

if TYPE_CHECKING:
    from fiohost.importing.found import Answers

Command = TypeVar("Command", bound=Callable[..., Any])
COLUMN, NUMBER = "COLUMN", "N"
OPTIONS = (
    ("--time", COLUMN, "Which column of a table is the time."),
    ("--command", COLUMN, "Which column is the command: duty, PWM or voltage."),
    ("--measured", COLUMN, "Which column is measured: angle, speed or position."),
    ("--unit", "UNIT", "Unit of the measured column: deg, rad, rev, counts, deg/s, rpm, m, ..."),
    ("--full-scale", "X", "What of the command is 100 %, in its own unit: 12 for 12 V, 255 for PWM."),
    ("--counts-per-rev", NUMBER, "Counts of a turn."),
    ("--sample-time", "S", "Seconds between rows, where no column is one of time."),
)


@dataclass(frozen=True)
class Told:
    """What a command line says of foreign tables: a map, or answers in the place of what would be found."""

    table_map: str | None
    texts: tuple[str | None, ...]

    def __bool__(self) -> bool:
        return self.table_map is not None or any(text is not None for text in self.texts)

    @property
    def option(self) -> str:
        """The first answer that was given, as it is written; without one that of a map."""
        return next((o for (o, _, _), text in zip(OPTIONS, self.texts, strict=True) if text is not None), "--map")

    @property
    def answers(self) -> Answers:
        """Raises ConfigError for a number that is none, and beside a map."""
        from fiohost.importing.found import Answers

        time, command, measured, unit, full_scale, counts, sample_time = self.texts
        if self.table_map is not None and any(text is not None for text in self.texts):
            raise ConfigError("--map says which column is what; leave the other answers away, or leave the map away")
        return Answers(
            time, command, measured, unit,
            None if full_scale is None else parse_number("--full-scale", full_scale, 1e-9, 1e9),
            None if counts is None else parse_number("--counts-per-rev", counts, 1.0, 1e9),
            None if sample_time is None else parse_number("--sample-time", sample_time, 1e-7, 3600.0, "s"),
        )  # fmt: skip

    @property
    def how(self) -> str | Answers:
        """What reads logs takes. Raises ConfigError."""
        answers = self.answers
        return answers if self.table_map is None else self.table_map


def table_options(map_help: str) -> Callable[[Command], Command]:
    """Add ``--map`` and the answers that stand for one, as one argument ``told``."""

    def add(command: Command) -> Command:
        names = [option[2:].replace("-", "_") + "_told" for option, _, _ in OPTIONS]

        @wraps(command)
        def given(*args: Any, table_map: str | None, **values: Any) -> Any:
            told = Told(table_map, tuple(values.pop(name) for name in names))
            return command(*args, told=told, **values)

        found: Any = given
        for (option, metavar, text), name in reversed(list(zip(OPTIONS, names, strict=True))):
            found = click.option(option, name, metavar=metavar, help=text)(found)
        return click.option("--map", "table_map", metavar="MAP", help=map_help)(found)  # type: ignore[no-any-return]

    return add
