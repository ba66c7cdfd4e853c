"""What the sections of ``docs/measured.md`` share: tables, words, pictures, and tables of data cut in two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from fiohost.estimation.intervals import Estimate
from fiohost.report import words
from fiohost.report.plots import as_png
from fiohost.report.series import SeriesPlot

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"


def save(name: str, figure: Figure) -> None:
    IMAGES.mkdir(exist_ok=True)
    (IMAGES / f"measured_{name}.png").write_bytes(as_png(figure, dpi=90))


def begun(series: SeriesPlot, seconds: float, first_s: float = 0.0) -> SeriesPlot:
    """A piece of a log as it is drawn."""
    part = (series.time_s >= first_s) & (series.time_s < first_s + seconds)
    return replace(
        series,
        time_s=series.time_s[part],
        measured=series.measured[part],
        before=None if series.before is None else series.before[part],
        after=None if series.after is None else series.after[part],
        duty_pct=None if series.duty_pct is None else series.duty_pct[part],
    )


def halves(source: Path, folder: Path) -> tuple[Path, Path]:
    """The first and the second half of a table's rows, as two tables in another folder."""
    head, *rows = source.read_text(encoding="utf-8").splitlines(keepends=True)
    middle = len(rows) // 2
    parts = []
    for name, piece in (("first", rows[:middle]), ("second", rows[middle:])):
        path = folder / f"{source.stem}_{name}_half.csv"
        path.write_text(head + "".join(piece), encoding="utf-8")
        parts.append(path)
    return parts[0], parts[1]


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; the first column is text, the others are numbers. Raises ValueError for an odd row."""
    if any(len(row) != len(head) for row in rows):
        raise ValueError(f"a row of the table of {head[0]!r} has not {len(head)} cells")
    lines = [f"| {' | '.join(head)} |", f"|---|{'---:|' * (len(head) - 1)}"]
    return "\n".join([*lines, *(f"| {' | '.join(row)} |" for row in rows)]) + "\n"


def pair(errors: Mapping[str, Any], scale: float = 1.0) -> list[str]:
    return [words.number(scale * errors[key], 3) for key in ("free_run_rms", "window_rms")]


def error_table(told: Mapping[str, Any], scale: float = 1.0) -> str:
    """Pooled errors after every step, ``scale`` times those of the diagnosis."""
    stages = [(told["declared"]["model"], told["before"]), *((f"+ {s['effect']}", s["after"]) for s in told["steps"])]
    stages.append((f"floor (from {told['floor']['from']})", told["floor"]))
    head = ["model", "fitted, whole run", "fitted, windows", "held out, whole run", "held out, windows"]
    return table(head, [[name, *pair(e["train"], scale), *pair(e["holdout"], scale)] for name, e in stages])


def log_table(told: Mapping[str, Any], scale: float = 1.0) -> str:
    """Errors of every log before and after, beside its floor."""
    head = ["log", "role", "before, whole", "windows", "after, whole", "windows", "floor, whole", "windows"]
    rows = [
        [
            f"`{Path(log['file']).stem}`",
            words.ROLE_WORDS[log["role"]],
            *(figure for stage in ("before", "after", "floor") for figure in pair(log[stage], scale)),
        ]
        for log in told["logs"]
    ]
    return table(head, rows)


def parameter_table(told: Mapping[str, Any]) -> str:
    rows = [
        [f"`{name}`", words.number(p["value"], 4), words.interval(p), p["unit"], words.remark(p)]
        for name, p in told["final"]["parameters"].items()
    ]
    return table(["parameter", "value", "95 % interval", "unit", "remark"], rows)


def names_text(told: Mapping[str, Any]) -> str:
    """One line an effect: what it did to the held-out runs, and what it cannot be told from."""
    lines = []
    was = told["before"]["holdout"]["window_rms"]
    for step in told["steps"]:
        now = step["after"]["holdout"]["window_rms"]
        change = 100.0 * (now / was - 1.0)
        was = now
        rivals = [words.effect_words(name) for name in step["indistinguishable_from"]]
        text = f"- **{words.effect_words(step['effect'])}**: {change:+.1f} % error in windows of held-out runs."
        if change > -2.0:
            text += " That is no help to runs that took no part: do not believe this step."
        lines.append(text + (f"\n  These data cannot tell it from {words.listed(rivals, 'or')}." if rivals else ""))
    return "\n".join(lines) + ("\n" if lines else "")


def with_interval(estimate: Estimate, scale: float = 1.0, digits: int = 3) -> str:
    """A value and half the width of its 95 % interval."""
    return f"{scale * estimate.value:.{digits}f} ± {abs(scale) * estimate.half_width:.{digits}f}"


def common(told: Mapping[str, Any], scale: float = 1.0) -> dict[str, str]:
    """What every section says of a diagnosis."""
    return {
        "verdict": words.verdict_sentence(told),
        "own": words.own_start_sentence(told),
        "verdict_name": told["verdict"],
        "short": ", ".join(words.effect_words(step["effect"]) for step in told["steps"]) or "nothing",
        "names": names_text(told),
        "parameters": parameter_table(told),
        "errors": error_table(told, scale),
        "logs": log_table(told, scale),
        "delay": told["semantics"]["command_delay"]["sentence"],
        "next": (told["next_experiment"] or {}).get("why", "none that would help"),
        "seconds": f"{told['seconds']:.0f}",
    }
