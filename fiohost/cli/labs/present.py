"""How the result of a lab is shown: tables, answers, pictures and a page in a folder, JSON."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from fiohost import files
from fiohost.cli.output import Output, json_option
from fiohost.cli.progress import progress

if TYPE_CHECKING:
    from fiohost.labs.result import LabResult, Table

MOST_COLUMNS = 1000

Command = TypeVar("Command", bound=Callable[..., Any])


def result_options(command: Command) -> Command:
    """Add ``--report DIR`` and ``--json FILE|-``, as arguments ``report`` (text) and ``json_to``."""
    command = click.option(
        "--worksheet", type=click.Path(path_type=Path), metavar="PAGE.html", expose_value=False, callback=_worksheet,
        help="Write a page with blanks for what is found, and print no answers.",
    )(command)  # fmt: skip
    command = click.option(
        "--answers", type=click.Path(path_type=Path), metavar="FILE", expose_value=False, callback=_worksheet,
        help="With --worksheet, for the teacher: write the answers as JSON.",
    )(command)  # fmt: skip
    text = "Folder for pictures and logs, new or empty.  [default: lab, or lab-N]"
    command = click.option("--report", metavar="DIR", help=text)(command)
    return json_option(command)


def report_folder(report: str | None) -> Path:
    """The folder of ``--report``, made before any work is done. Raises FiohostError."""
    return files.report_folder(Path(report or "lab"), chosen=report is not None)


def present(result: LabResult, out: Output, folder: Path) -> None:
    """Print a result, save its pictures as ``FOLDER/NAME.png`` and its page as ``FOLDER/LAB.html``, write its JSON; or
    write a worksheet of it.
    """
    meta = click.get_current_context().meta
    if meta.get("worksheet"):
        _write_worksheet(result, out, meta)
        return
    out.json(show(result, out, folder))


def _worksheet(ctx: click.Context, parameter: click.Parameter, value: Path | None) -> None:
    if value is not None and not ctx.resilient_parsing:
        ctx.meta[str(parameter.name)] = files.claim(value)


def _write_worksheet(result: LabResult, out: Output, meta: dict[str, Any]) -> None:
    """The page with blanks for the student, and all answers for the teacher where a file is named for them."""
    import json

    from fiohost.errors import ConfigError
    from fiohost.report.worksheet import worksheet_page
    from fiohost.strict_json import plain

    if out.json_to is not None:
        raise ConfigError("a worksheet has no answers, so there is no --json beside it; --answers FILE writes them")
    student = str(meta.get("student") or "")
    files.write_output(meta["worksheet"], worksheet_page(result, student))
    out(f"{result.title}: worksheet in {meta['worksheet']}")
    if meta.get("answers"):
        told = {**result.to_json(), "student": student}
        files.write_output(meta["answers"], json.dumps(plain(told), indent=2, allow_nan=False) + "\n")
        out(f"answers, for the teacher: {meta['answers']}")


def show(result: LabResult, out: Output, folder: Path) -> dict[str, Any]:
    """Print a result, save its pictures and its page; gives what its JSON is, for a command that has several."""
    if click.get_current_context().meta.get("worksheet"):
        from fiohost.errors import ConfigError

        raise ConfigError("a worksheet is of one experiment or problem: name it")
    out(f"{result.title}  [{result.target}]")
    for table in result.tables:
        _print_table(table, out)
    for answer in result.answers:
        out(f"\n{answer.question}\n  {answer.answer}")
    for note in result.notes:
        out(f"note: {note}")
    from fiohost.report.lab import write_lab_page
    from fiohost.report.pictures import save_figure

    made = dict(result.files)
    pictures = {}
    with progress() as doing:
        for name, draw in result.figures.items():
            doing(f"picture {name}")
            path = save_figure(draw(), folder / f"{name}.png")
            made[name], pictures[name] = str(path), path.read_bytes()
    made["page"] = str(write_lab_page(folder / f"{result.name}.html", result, pictures, made))
    for role, name in made.items():
        out(f"{role}: {name}")
    return {**result.to_json(), "files": made}


def _print_table(table: Table, out: Output) -> None:
    from rich import box
    from rich.table import Table as RichTable

    from fiohost.report.lab import cell_text

    shown = RichTable(title=table.title, title_justify="left", box=box.SIMPLE_HEAD)
    for i, column in enumerate(table.columns):
        numbers = all(not isinstance(row[i], str) for row in table.rows)
        shown.add_column(column, justify="right" if numbers else "left")
    for row in table.rows:
        shown.add_row(*(cell_text(cell) for cell in row))
    console = out.console
    whole = console.measure(shown, options=console.options.update(width=MOST_COLUMNS)).maximum
    console.width = max(console.width, whole)  # a line may be long, a number is never cut
    console.print(shown)
