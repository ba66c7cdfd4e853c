"""What people say of a table, what is found, and what stays unknown."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Answers:
    """What a person says of a table, each the better of what would be found; None where nothing is said."""

    time: str | None = None
    command: str | None = None
    output: str | None = None
    unit: str | None = None  # of the output
    full_scale: float | None = None  # of the command, in its unit
    counts_per_rev: float | None = None
    sample_time_s: float | None = None


@dataclass(frozen=True)
class Unknown:
    """Something that nobody can know from the table: which answer would say it, in words, and what may be answered."""

    key: str
    what: str
    option: str
    choices: tuple[str, ...] = ()


@dataclass
class Found:
    lines: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)
    unknown: list[Unknown] = field(default_factory=list)
    used: set[str] = field(default_factory=set)
