"""A lab as a page with blanks: the text's questions and what is set beforehand stay, all that is found is left out."""

from __future__ import annotations

import html
from collections.abc import Iterator

from fiohost.labs.questions import paired
from fiohost.labs.result import LabResult, Table
from fiohost.report.lab import cell_text

STYLE = """
body { font: 16px/1.45 system-ui, sans-serif; max-width: 52rem; margin: 1.5rem auto; padding: 0 1rem; color: #111; }
table { border-collapse: collapse; margin: .5rem 0 1.2rem; } th, td { border: 1px solid #999; padding: .3rem .6rem; }
th { background: #f2f2f2; text-align: left; } td.blank { min-width: 5.5rem; height: 1.6rem; }
.line { border-bottom: 1px solid #999; height: 1.9rem; } h2 { font-size: 1.05rem; margin-top: 1.6rem; }
.where { color: #555; font-weight: 400; font-size: .88rem; }
.head { display: flex; gap: 1.5rem; } .head div { flex: 1; border-bottom: 1px solid #999; padding-top: 1.2rem; }
@media print { body { margin: 0; } table, .question { break-inside: avoid; } }
"""
LINES = 3  # for an answer


def worksheet_page(result: LabResult, student: str = "") -> str:
    """The page of one lab's result without its answers: each table shows its ``given`` columns only."""
    title = html.escape(result.title)
    parts = [
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>',
        f"<style>{STYLE}</style></head>",
        f'<body><h1>{title}</h1><div class="head"><div>name: {html.escape(student)}</div><div>date:</div></div>',
    ]
    for table in result.tables:
        parts += _table(table)
    lines = '<div class="line"></div>' * LINES
    for number, (question, where) in enumerate(_questions(result), start=1):
        told = f' <span class="where">({html.escape(where)})</span>' if where else ""
        parts.append(f'<div class="question"><h2>{number}. {html.escape(question)}{told}</h2>{lines}</div>')
    parts.append("</body></html>\n")
    return "\n".join(parts)


def _questions(result: LabResult) -> Iterator[tuple[str, str]]:
    """The text's questions with their sections, then those that the lab puts beside them."""
    pairs = paired(result)
    for item, _ in pairs.asked:
        yield item.text, item.where
    for answer in pairs.others:
        yield answer.question, ""


def _table(table: Table) -> Iterator[str]:
    yield f"<h2>{html.escape(table.title)}</h2><table><tr>"
    yield "".join(f"<th>{html.escape(name)}</th>" for name in table.columns)
    yield "</tr>"
    for row in table.rows:
        cells = (
            f"<td>{html.escape(cell_text(cell))}</td>" if place in table.given else '<td class="blank"></td>'
            for place, cell in enumerate(row)
        )
        yield f"<tr>{''.join(cells)}</tr>"
    yield "</table>"
