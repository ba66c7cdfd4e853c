"""What to do next and what was out of reach, in words: next experiment, detection limits, the empirical term.

Knows the JSON of a diagnosis (schema ``fiohost.diagnosis/1``) and nothing else; a diagnosis without these keys has
nothing to say.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from fiohost.report.words import FOLLOWS, effect_words, listed, number, searched_unit, with_unit

if TYPE_CHECKING:
    from rich.console import Console

PARITY = {
    "even": "the same in both directions, as of a load",
    "odd": "turning round with the direction, as of friction",
    "mixed": "neither the same nor opposite in the two directions",
}
# A size so far from where an effect vanishes is told as it is, a nearer one as how far it lies from there.
FAR = 0.2
KIND = {"torque": "a missing torque", "measurement": "an error of measurement"}


def upcoming_sentence(diagnosis: Mapping[str, Any]) -> str:
    """Why the next experiment, or why none; empty where there is nothing to say."""
    why = (diagnosis.get("next_experiment") or diagnosis.get("separation") or {}).get("why") or ""
    return f"{why[0].upper()}{why[1:]}." if why else ""


def upcoming_words(diagnosis: Mapping[str, Any]) -> str:
    """The command of the next experiment, or what it is in words; empty where there is none."""
    upcoming = diagnosis.get("next_experiment")
    if not upcoming:
        return ""
    name = str(upcoming.get("experiment"))
    return name if upcoming.get("in_words") else f"fiohost run {name}"


def empirical_sentence(diagnosis: Mapping[str, Any]) -> str:
    """What the empirical term says; empty where there is none."""
    term = (diagnosis.get("residual") or {}).get("empirical")
    if not term:
        return ""
    variable = str(term.get("variable"))
    parity = PARITY.get(str(term.get("parity")))
    follows = FOLLOWS.get(variable, variable.replace("_", " "))
    taken, by_chance = (number(100.0 * float(term[key]), 2) for key in ("share_of_power", "by_chance"))
    text = (
        f"Empirical, not a named effect: {KIND.get(str(term.get('kind')), 'a term')} that follows {follows} would take "
        f"{taken} % of what remains in 1 s windows (by chance {by_chance} %); what remains is "
        f"{number(term.get('residual_over_floor'), 3)} times the floor"
    )
    return f"{text}. It is {parity}." if parity else f"{text}."


def curves_sentence(diagnosis: Mapping[str, Any]) -> str:
    """What curves of no name in the model that is handed over are worth; empty where there are none."""
    told, unit = diagnosis.get("unnamed"), searched_unit(diagnosis)
    if not isinstance(told, Mapping):
        return ""
    names = listed(f"a {effect_words(str(name))}" for name in told["effects"])
    before, after = (with_unit(told[key]["window_rms"], unit) for key in ("before", "after"))
    return (
        f"The model that is handed over (--save-model) has {names} besides, curves of no name: windows of 1 s "
        f"of the training logs err by {after} with them, {before} without."
    )


def extrapolation_sentences(diagnosis: Mapping[str, Any]) -> list[str]:
    """Of every held-out log that goes beyond what the training logs did, where."""
    return [
        f"{one['log']} goes beyond the training logs: {listed(one['beyond'])}; there the model extrapolates and "
        "answers for nothing."
        for one in diagnosis.get("extrapolates") or []
    ]


def limit_rows(diagnosis: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Rows of the detection limits: effect with its other parameters, parameter, the smallest size that shows."""
    rows = []
    for limit in diagnosis.get("detection_limits") or []:
        given = given_words(limit)
        name = effect_words(str(limit.get("effect"))) + (f" ({given})" if given else "")
        rows.append((name, str(limit.get("parameter")), size_words(limit)))
    return rows


def given_words(limit: Mapping[str, Any]) -> str:
    """The other parameters of an effect with a limit."""
    at = limit.get("at") or {}
    return ", ".join(f"{k} {v if isinstance(v, str) else f'{v:.3g}'}" for k, v in at.items()).replace("_", " ")


def limit_words(limit: Mapping[str, Any]) -> str:
    """A limit without its effect: ``gap_deg 0.04 deg (side encoder after gap)``, or why there is none."""
    if limit.get("smallest_visible") is None:
        return str(limit.get("reason"))
    given = given_words(limit)
    return f"{limit.get('parameter')} {size_words(limit)}" + (f" ({given})" if given else "")


def size_words(limit: Mapping[str, Any]) -> str:
    """``0.003 above 1.00``, ``0.4 %``, or why there is no size."""
    value, neutral, unit = limit.get("smallest_visible"), limit.get("neutral"), str(limit.get("unit") or "")
    if value is None:
        return f"no size: {limit.get('reason')}"
    if not neutral or abs(value - neutral) > FAR * abs(neutral):
        return with_unit(abs(value) if neutral == 0.0 else value, unit, 2)
    side = "above" if value > neutral else "below"
    return f"{with_unit(abs(value - neutral), unit, 2)} {side} {number(neutral, 3)}"


def print_outlook(console: Console, diagnosis: Mapping[str, Any]) -> None:
    """The empirical term, detection limits and the next experiment."""
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

    told = [empirical_sentence(diagnosis), curves_sentence(diagnosis), *extrapolation_sentences(diagnosis)]
    for sentence in (text for text in told if text):
        console.print(Text(sentence))
        console.print()
    rows = limit_rows(diagnosis)
    if rows:
        title = Text("Smallest effect that these data would have shown", style="bold")
        table = Table(title=title, title_justify="left", box=None, pad_edge=False, header_style="dim")
        for name in ("effect", "parameter"):
            table.add_column(name, no_wrap=True)
        table.add_column("smallest visible", justify="left")
        for row in rows:
            table.add_row(*(Text(cell) for cell in row))
        console.print(table)
        console.print()
    what, why = upcoming_words(diagnosis), upcoming_sentence(diagnosis)
    if what:
        console.print(Text.assemble(("Next experiment: ", "bold"), what))
        console.print(Padding(Text(why), (0, 0, 0, 2)))
    elif why:
        console.print(Text(why))
