"""Before any dynamics, in words: faults of the raw data, what a command means, what the logs cannot show.

Knows the JSON of a diagnosis (schema ``fiohost.diagnosis/1``) and nothing else; a diagnosis without these keys has
nothing to say.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from fiohost.report.words import effect_words, error_of, listed, number

if TYPE_CHECKING:
    from rich.console import Console

LOGS_NAMED = 3
QUESTIONS = {
    "command_delay": "ticks until a command acts",
    "zero_duty": "what zero duty does",
    "decay": "bridge between pulses",
}
EXERCISED = (
    ("seconds", "seconds of logs"),
    ("speed_min", "lowest speed"),
    ("speed_max", "highest speed"),
    ("reversals", "reversals"),
    ("starts", "starts from standstill"),
    ("standstill_s", "seconds at standstill"),
    ("slow_s", "seconds below a tenth of the top speed"),
    ("braking_s", "seconds of turning against the command"),
    ("turns", "turns covered"),
    ("useful_hz", "movement stands above the counts up to (Hz)"),
    ("levels", "levels of duty, by tens"),
    ("duty_max_pct", "largest duty (%)"),
    ("largest_step_pct", "largest step of the duty (%)"),
    ("saturated_pct", "rows at full scale (%)"),
)


def findings(diagnosis: Mapping[str, Any], *, harm: bool | None = None) -> list[dict[str, str]]:
    """Faults of the raw data, one row a kind, worst first: ``name``, ``severity``, ``count``, ``where``, ``advice``.

    ``harm`` chooses those that a fit suffers by, or those that it does not; None takes all.
    """
    kinds: dict[tuple[bool, str], list[Mapping[str, Any]]] = {}
    for item in diagnosis.get("kinematics") or []:
        kinds.setdefault((item.get("severity") == "harm", str(item.get("name"))), []).append(item)
    rows = []
    for (bad, name), items in sorted(kinds.items(), key=lambda kind: not kind[0][0]):
        if harm is not None and bad != harm:
            continue
        worst = max(items, key=lambda i: int(i.get("count") or 0))
        rows.append(
            {
                "name": name.replace("_", " "),
                "severity": "harm" if bad else "note",
                "count": str(sum(int(i.get("count") or 0) for i in items)),
                "where": _where(items),
                "advice": str(worst.get("advice", "")),
            }
        )
    return rows


def _where(items: list[Mapping[str, Any]]) -> str:
    named = []
    for item in items[:LOGS_NAMED]:
        times = [number(t) for t in (item.get("times_s") or [])[:2]]
        named.append(f"{item.get('log')}" + (f" at {listed(times)} s" if times else ""))
    rest = len(items) - LOGS_NAMED
    return "; ".join(named) + (f"; and {rest} more logs" if rest > 0 else "")


def questions(diagnosis: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """The questions of what a command means that were asked, with a name for people."""
    block = diagnosis.get("semantics") or {}
    return [(words, block[key]) for key, words in QUESTIONS.items() if isinstance(block.get(key), Mapping)]


def answers(question: Mapping[str, Any]) -> str:
    """The window error under each answer in a line."""
    errors = question.get("window_rms") or {}
    return ", ".join(f"{name}: {number(value, 3)}" for name, value in errors.items())


def warnings(diagnosis: Mapping[str, Any]) -> list[str]:
    """What must be known before the verdict is believed, a sentence each."""
    told = [f"{row['where']}: {row['advice']}." for row in findings(diagnosis, harm=True)]
    told += [f"{name}: {words}." for name, words in not_followed(diagnosis).items()]
    contradicted = [q for _, q in questions(diagnosis) if q.get("verdict") in ("contradicted", "suspected")]
    return [_sentence(text) for text in [*(f"{q.get('sentence')}." for q in contradicted), *told]]


def not_followed(diagnosis: Mapping[str, Any]) -> dict[str, str]:
    """Of every held-out log that the final model does not follow, by name, how far it is off and what that means."""
    blocks = {b.get("file"): b for b in diagnosis.get("logs") or [] if b.get("role") == "holdout"}
    told = {}
    for name in dict.fromkeys(e.get("log") for e in diagnosis.get("holdout_not_followed") or []):
        block = blocks.get(name) or {}
        parts = [
            f"{number(after / floor, 3)} times its floor in {where}"
            for where, key in (("1 s windows", "window_rms"), ("the whole run", "free_run_rms"))
            if (after := error_of(block, "after", key)) is not None and (floor := error_of(block, "floor", key))
        ]
        told[str(name)] = (
            f"held out, the model does not follow it ({listed(parts)}), though it follows all training logs; this log "
            "shows something that none of those does: diagnose it among them"
        )
    return told


def _sentence(text: str) -> str:
    # A file's name keeps its letters.
    return text if "." in text.split(" ", 1)[0] else text[0].upper() + text[1:]


def _not_shown(diagnosis: Mapping[str, Any]) -> list[tuple[list[str], str]]:
    """Effects in words that the logs cannot show, and why; what was found in them all the same is not among these."""
    found = {step.get("effect") for step in diagnosis.get("steps") or []}
    rows = []
    for item in (diagnosis.get("data") or {}).get("cannot_show") or []:
        names = [effect_words(str(n)) for n in item.get("effects") or [] if n not in found]
        if names:
            rows.append((names, str(item.get("why", ""))))
    return rows


def limits(diagnosis: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What the logs cannot show or tell apart, as (effects in words, why)."""
    rows = [(f"cannot show {listed(names, 'or')}", why) for names, why in _not_shown(diagnosis)]
    for item in (diagnosis.get("data") or {}).get("cannot_tell_apart") or []:
        names = [effect_words(str(n)) for n in item.get("effects") or []]
        rows.append((f"cannot tell {listed(names, 'from')}", str(item.get("why", ""))))
    return rows


def exercised(diagnosis: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What the logs went through, as (what, how much)."""
    data = diagnosis.get("data") or {}
    rows = [(words, number(data[key], 3)) for key, words in EXERCISED if data.get(key) is not None]
    if data:
        rows.append(("both directions", "yes" if data.get("both_directions") else "no"))
        rows.append(("closed loop only", "yes" if data.get("closed_loop_only") else "no"))
    return rows


def print_preliminary(console: Console, diagnosis: Mapping[str, Any], verbose: bool = False) -> None:
    """Print what matters before the figures; all of it where ``verbose``."""
    from rich.text import Text

    told = warnings(diagnosis)
    hidden = sorted({name for names, _ in _not_shown(diagnosis) for name in names})
    for sentence in told:
        console.print(Text.assemble(("Warning: ", "bold yellow"), sentence))
    if hidden and not verbose:
        console.print(Text(f"These logs cannot show {listed(hidden, 'or')} (why: -v or the page)."))
    if verbose:
        for row in findings(diagnosis, harm=False):
            console.print(Text(f"Note: {row['where']}: {row['advice']}."))
        for item in diagnosis.get("kinematics_skipped") or []:
            console.print(Text(f"Not checked: {item.get('log')}, {item.get('name')}: {item.get('why')}.", style="dim"))
        for name, question in questions(diagnosis):
            errors = answers(question)
            said = f"{question.get('sentence')}" + (f" (window error by answer: {errors})" if errors else "")
            console.print(Text(f"Asked: {name}: {said}."))
        for what, why in limits(diagnosis):
            console.print(Text(f"These logs {what}: {why}."))
        seen = ", ".join(f"{what} {value}" for what, value in exercised(diagnosis))
        if seen:
            console.print(Text(f"Exercised: {seen}.", style="dim"))
    if told or hidden or (verbose and diagnosis.get("data")):
        console.print()
