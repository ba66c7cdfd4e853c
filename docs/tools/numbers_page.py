"""Writes docs/reference/numbers.md: every number that decides in a diagnosis, from the settings and the reasons there.

Usage: ``python docs/tools/numbers_page.py``.
"""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE = ROOT / "docs" / "reference" / "numbers.md"
SOURCES = (
    "fiohost/discover/settings.py",
    "fiohost/discover/tables/settings.py",
    "fiohost/judging/settings.py",
    "fiohost/discover/degenerate.py",
    "fiohost/discover/logs/own_start.py",
    "fiohost/noise/settings.py",
    "fiohost/estimation/settings.py",
    "fiohost/estimation/stamps.py",
    "fiohost/estimation/counted.py",
)
HEAD = """# The numbers of a diagnosis

Every number that decides in a diagnosis, its value and the reason for it. They are frozen, and printed in every result
under `settings`. The method is told in [How a diagnosis is made](../method.md).
"""


def rows(node: ast.ClassDef, lines: list[str]) -> list[tuple[str, str, str]]:
    """Name, value and reason of each field; a reason stands above the fields that it is for."""
    found: list[tuple[str, str, str]] = []
    for field in node.body:
        if not isinstance(field, ast.AnnAssign) or field.value is None or not isinstance(field.target, ast.Name):
            continue
        above = field.lineno - 2
        said: list[str] = []
        while lines[above].strip().startswith("#"):
            said.insert(0, lines[above].strip().lstrip("# "))
            above -= 1
        value = " ".join(ast.unparse(field.value).split())
        if not ast.unparse(field.annotation).endswith("Settings"):
            found.append((field.target.id, value, " ".join(said) or ("as above" if found else "")))
    return found


def page() -> str:
    """The whole page as Markdown."""
    parts = [HEAD]
    for source in SOURCES:
        text = (ROOT / source).read_text(encoding="utf-8")
        for node in ast.parse(text).body:
            if isinstance(node, ast.ClassDef) and node.name.endswith("Settings"):
                doc = (ast.get_docstring(node) or node.name).splitlines()[0].rstrip(".")
                parts.append(f"\n## {doc}\n\n`{source}`\n\n| number | value | reason |\n|---|---|---|")
                told = rows(node, text.splitlines())
                parts += [f"| `{name}` | `{value}` | {reason.replace('|', '/')} |" for name, value, reason in told]
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
