"""The closed circle in a terminal and as a picture: what was found, the proof on a fresh record, the opened seal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from fiohost.report import words
from fiohost.report.page import confirm_sentence, flatten
from fiohost.report.series import SeriesPlot
from fiohost.report.tables import print_diagnosis

if TYPE_CHECKING:
    from rich.console import Console

    from fiohost.circle.close import Circle


def print_circle(console: Console, result: Mapping[str, Any], verbose: bool = False) -> None:
    """Print a result of schema ``fiohost.circle/1``: diagnosis, confirmation, and last the truth where there is
    a seal.
    """
    diagnosis = result["diagnosis"]
    print_diagnosis(console, diagnosis, verbose)
    console.print()
    if result["follow_up"]:
        console.print(f"[bold]Follow-up[/bold]: {follow_up_sentence(result['follow_up'])}")
    console.print(f"[bold]Fresh record[/bold]: {confirm_sentence(result['confirm'], str(diagnosis['output_unit']))}")
    if result["seal"]:
        console.print()
        console.print("[bold]The seal, opened now[/bold]")
        for name, text in flatten(result["seal"]):
            console.print(f"  {name}: {text}", markup=False)
        named = [words.effect_words(step["effect"]) for step in diagnosis["steps"]]
        console.print(f"  named before it was opened: {words.listed(named) or 'nothing'}")


def follow_up_sentence(follow_up: Mapping[str, Any]) -> str:
    """What the experiment that was run to tell rivals apart made of the names."""

    def spoken(named: Sequence[Sequence[str]]) -> str:
        return words.listed(words.listed(map(words.effect_words, names), "or") for names in named) or "nothing"

    before, after = follow_up["named_before"], follow_up["named_after"]
    count, left = (sum(len(names) for names in named) for named in (before, after))
    change = f"{count} names became {left}" if left < count else "the names did not become fewer"
    return (
        f"{follow_up['experiment']} was run to tell rivals apart: {change}. Before it: {spoken(before)}; "
        f"after it: {spoken(after)}."
    )


def confirm_series(circle: Circle) -> SeriesPlot:
    """The fresh record, measured against both models."""
    from fiohost.judging.followed import bench_angle

    found = circle.confirmation
    record = found.record
    return SeriesPlot(
        title=record.name,
        role="confirm",
        unit=record.unit,
        time_s=record.excitation.times_s,
        measured=record.y - record.ahead_deg,
        before=found.before.simulated - record.ahead_deg,
        after=found.after.simulated - record.ahead_deg if circle.diagnosis.steps else None,
        duty_pct=record.excitation.duties_pct[1:],
        floor_rms=found.floor.errors.free_run_rms,
        angle=bench_angle(record, found.after),
        quantum=record.quantum,
    )
