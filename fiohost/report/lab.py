"""One self-contained HTML page of a lab: the text's questions with the answers of this run, tables, plots and files."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import jinja2

from fiohost import __version__
from fiohost.files import write_output
from fiohost.labs.questions import paired
from fiohost.report.page import STYLE

if TYPE_CHECKING:
    from fiohost.labs.result import Cell, LabResult, Table

WORD = re.compile(r"[a-z]{2,}(?=[:,;]? (?!=))|a(?= [a-z])")  # not a symbol, which has = behind it
WIDEST = 24  # characters of a cell that stays on one line
TEMPLATE = Path(__file__).with_name("lab.html.j2")


def write_lab_page(path: Path, result: LabResult, pictures: Mapping[str, bytes], files: Mapping[str, str]) -> Path:
    """Write the page, whole or not at all; ``pictures`` are PNGs by name. Raises FiohostError."""
    write_output(path, render_lab(result, pictures, files))
    return path


def render_lab(result: LabResult, pictures: Mapping[str, bytes], files: Mapping[str, str]) -> str:
    """The page as text. Nothing in it is loaded from anywhere."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"cell": cell_text, "sentence": sentence}
    pairs = paired(result)
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        result=result,
        style=STYLE.read_text(encoding="utf-8"),
        version=__version__,
        asked=pairs.asked,
        others=pairs.others,
        pictures=[(name, base64.b64encode(data).decode("ascii")) for name, data in pictures.items()],
        files=files,
        numbers=_numbers,
        wide=_wide,
    )


def cell_text(cell: Cell) -> str:
    """A cell as it is printed: four significant digits."""
    if cell is None:
        return ""
    return f"{cell:.4g}" if isinstance(cell, float) else str(cell)


def sentence(text: str) -> str:
    """An answer as a page has it: with a capital where it begins with a word, and a full stop."""
    begun = text[:1].upper() + text[1:] if WORD.match(text) else text
    return begun if not begun or begun[-1] in ".:?!" else f"{begun}."


def _numbers(table: Table, column: int) -> bool:
    """Whether a column holds numbers only."""
    return all(not isinstance(row[column], str) for row in table.rows)


def _wide(table: Table, column: int) -> bool:
    """Whether a column of text has cells that are to be broken into lines."""
    return any(len(cell_text(row[column])) > WIDEST for row in table.rows)
