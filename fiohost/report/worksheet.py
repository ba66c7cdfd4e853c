"""A lab as a page with blanks: titles, questions and what is given in each table stay, what is found is left out."""

from __future__ import annotations

import html
from collections.abc import Mapping
from typing import Any

STYLE = """
body { font: 16px/1.45 system-ui, sans-serif; max-width: 52rem; margin: 1.5rem auto; padding: 0 1rem; color: #111; }
table { border-collapse: collapse; margin: .5rem 0 1.2rem; } th, td { border: 1px solid #999; padding: .3rem .6rem; }
th { background: #f2f2f2; text-align: left; } td.blank { min-width: 5.5rem; height: 1.6rem; }
.line { border-bottom: 1px solid #999; height: 1.9rem; } h2 { font-size: 1.05rem; margin-top: 1.6rem; }
.head { display: flex; gap: 1.5rem; } .head div { flex: 1; border-bottom: 1px solid #999; padding-top: 1.2rem; }
@media print { body { margin: 0; } table, .question { break-inside: avoid; } }
"""
LINES = 3  # for an answer


def worksheet_page(result: Mapping[str, Any], student: str = "") -> str:
    """The page of one lab's result (schema ``fiohost.lab/1``), without its answers."""
    title = html.escape(str(result["title"]))
    parts = [
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>',
        f"<style>{STYLE}</style></head>",
        f'<body><h1>{title}</h1><div class="head"><div>name: {html.escape(student)}</div><div>date:</div></div>',
    ]
    for table in result.get("tables") or []:
        parts.append(f"<h2>{html.escape(str(table['title']))}</h2><table><tr>")
        parts += [f"<th>{html.escape(str(name))}</th>" for name in table["columns"]]
        parts.append("</tr>")
        for row in table["rows"]:
            cells = "".join(_cell(cell, given=place < table.get("given", 1)) for place, cell in enumerate(row))
            parts.append(f"<tr>{cells}</tr>")
        parts.append("</table>")
    for number, one in enumerate(result.get("answers") or [], start=1):
        lines = '<div class="line"></div>' * LINES
        parts.append(f'<div class="question"><h2>{number}. {html.escape(str(one["question"]))}</h2>{lines}</div>')
    parts.append("</body></html>\n")
    return "\n".join(parts)


def _cell(cell: Any, *, given: bool) -> str:
    if given or cell is None:  # where nothing can be found there is nothing to fill in
        text = f"{cell:.4g}" if isinstance(cell, float) else "–" if cell is None else str(cell)
        return f"<td>{html.escape(text)}</td>"
    return '<td class="blank"></td>'
