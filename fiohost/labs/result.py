"""What an experiment of a lab gives: tables, answers to the text's questions, notes and pictures.

An experiment returns a ``LabResult``; ``fiohost.cli.labs.present`` prints it, saves its pictures and writes its JSON.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Cell = float | int | str | None


@dataclass(frozen=True)
class Table:
    """A titled table: column names with their units, and rows of cells (None: empty).

    ``given`` are the places of the columns that are known before anything is done, such as a gain that is set: what a
    worksheet shows of the table. The title holds nothing that is found.
    """

    title: str
    columns: tuple[str, ...]
    rows: Sequence[Sequence[Cell]]
    given: tuple[int, ...] = (0,)

    def to_json(self) -> dict[str, Any]:
        return {"title": self.title, "columns": list(self.columns), "rows": [list(row) for row in self.rows]}


@dataclass(frozen=True)
class Answer:
    """A question or numbered step of the text, in our words, and its answer by the numbers of this very run."""

    question: str
    answer: str

    def to_json(self) -> dict[str, str]:
        return {"question": self.question, "answer": self.answer}


@dataclass(frozen=True)
class LabResult:
    """All that one experiment found.

    ``values`` are the figures for programs, with units in their keys; ``figures`` draws each picture when it is asked
    for, by the name of its file without ending; ``files`` are what was written beside (logs, animations), by role.
    """

    name: str
    title: str
    target: str
    tables: tuple[Table, ...] = ()
    answers: tuple[Answer, ...] = ()
    notes: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)
    figures: Mapping[str, Callable[[], Figure]] = field(default_factory=dict, repr=False)
    files: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        return {
            "schema": "fiohost.lab/1",
            "lab": self.name,
            "title": self.title,
            "target": self.target,
            "values": dict(self.values),
            "tables": [t.to_json() for t in self.tables],
            "answers": [a.to_json() for a in self.answers],
            "notes": list(self.notes),
            "files": dict(self.files),
        }
