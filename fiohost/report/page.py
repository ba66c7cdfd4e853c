"""One self-contained HTML page of a diagnosis: verdict first, then figures, pictures, parameters and the opened seal.

Nothing in it is loaded from anywhere: style and pictures are inside, so that it can be mailed, printed and kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from fiohost import __version__
from fiohost.files import make_folder, write_output
from fiohost.report import preliminary, words
from fiohost.report.effect_curve import captions
from fiohost.report.outlook import (
    curves_sentence,
    empirical_sentence,
    extrapolation_sentences,
    limit_rows,
    upcoming_sentence,
    upcoming_words,
)
from fiohost.report.physical import headline, size_rows, spoken, unit_words
from fiohost.report.plots import (
    ROLES,
    as_svg,
    plot_answers,
    plot_candidates,
    plot_curve,
    plot_residual_bars,
    plot_separations,
)
from fiohost.report.records import records_script, records_style
from fiohost.report.residual import plot_residual, residual_of, white_words
from fiohost.report.series import CurvePlot, SeriesPlot

__all__ = ["CurvePlot", "SeriesPlot", "write_page"]

TEMPLATE = Path(__file__).with_name("page.html.j2")
STYLE = Path(__file__).with_name("page.css")


def write_page(
    path: Path,
    *,
    title: str,
    diagnosis: Mapping[str, Any],
    series: Sequence[SeriesPlot] = (),
    seal: Mapping[str, Any] | None = None,
    confirm: Mapping[str, Any] | None = None,
    curves: Sequence[CurvePlot] = (),
    follow_up: str = "",
) -> Path:
    """Write the page, whole or not at all, and return *path*.

    ``diagnosis`` follows ``fiohost.diagnosis/1``. ``confirm`` is the judgement on a fresh record: ``before``,
    ``after`` and ``floor`` like E of the diagnosis, optionally ``improvement_pct`` with its ``ci95`` and the figure
    that it is of, ``improvement_of`` (``free_run_rms`` or ``window_rms``); other keys are listed as they are.
    ``follow_up`` says what an experiment that was run in addition made of the names.
    ``seal`` is what a sealed bench turned out to be: any nested mapping.
    Raises FiohostError where the file cannot be written.
    """
    html = render(
        title=title, diagnosis=diagnosis, series=series, seal=seal, confirm=confirm, curves=curves, follow_up=follow_up
    )
    make_folder(path.parent)
    write_output(path, html)
    return path


def render(
    *,
    title: str,
    diagnosis: Mapping[str, Any],
    series: Sequence[SeriesPlot] = (),
    seal: Mapping[str, Any] | None = None,
    confirm: Mapping[str, Any] | None = None,
    curves: Sequence[CurvePlot] = (),
    follow_up: str = "",
) -> str:
    """The page as text."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["number"] = words.number
    environment.filters["effect"] = words.effect_words
    template = environment.from_string(TEMPLATE.read_text(encoding="utf-8"))
    logs = list(diagnosis.get("logs") or [])
    candidates = sorted(diagnosis.get("candidates") or [], key=lambda c: -float(c.get("score") or 0.0))
    steps = list(diagnosis.get("steps") or [])
    chosen = [str(step.get("effect")) for step in steps]
    unit = str(diagnosis.get("output_unit", ""))
    upcoming, separation = diagnosis.get("next_experiment"), diagnosis.get("separation")
    final = diagnosis.get("final") or diagnosis.get("declared") or {}
    asked = preliminary.questions(diagnosis)
    floor = (diagnosis.get("semantics") or {}).get("floor_window_rms")
    sizes = size_rows(diagnosis)
    records = [one for one in series if len(one.time_s) > 1]
    proof = [i for i, one in enumerate(records) if one.role in ("confirm", "holdout")]
    shown = proof or list(range(len(records)))[:1]
    left = residual_of(records[shown[0]]) if shown else None
    white = (diagnosis.get("residual") or {}).get("white")
    open_verdict = diagnosis.get("verdict") == "unexplained"
    found = [c for c in curves if c.found]
    others = [c for c in curves if not c.found]
    scored = [c for c in candidates if float(c.get("score") or 0.0) >= LEAST_SCORE]
    return template.render(
        title=title,
        style=STYLE.read_text(encoding="utf-8"),
        version=diagnosis.get("fiohost_version", __version__),
        verdict=str(diagnosis.get("verdict", "")),
        sentence=words.verdict_sentence(diagnosis),
        headline=headline(diagnosis),
        sizes=sizes,
        physical=any(row["physical"] for row in sizes),
        captions=captions(diagnosis),
        unit=unit,
        searched_unit=words.searched_unit(diagnosis),
        unit_words=unit_words,
        declared=str((diagnosis.get("declared") or {}).get("model", "")),
        final=final,
        stages=list(_stages(diagnosis)),
        warnings=preliminary.warnings(diagnosis),
        findings=preliminary.findings(diagnosis),
        skipped=diagnosis.get("kinematics_skipped") or [],
        asked=asked,
        answers=preliminary.answers,
        limits=preliminary.limits(diagnosis),
        exercised=preliminary.exercised(diagnosis),
        looked="data" in diagnosis,
        roles=words.roles_of(diagnosis),
        role_words=words.ROLE_WORDS,
        logs=[{**log, "name": Path(str(log.get("file", "?"))).name} for log in logs],
        error_of=words.error_of,
        interval=words.interval,
        remark=words.remark,
        steps=steps,
        rivals=lambda step: words.rivals_of(diagnosis, step),
        chosen=chosen,
        candidates=candidates,
        outcomes=_outcomes(candidates, chosen),
        follows=words.follows(diagnosis),
        white=white,
        white_words=white_words(left, white) if left else [],
        tests=_tests(diagnosis),
        upcoming=upcoming,
        upcoming_sentence=upcoming_sentence(diagnosis),
        upcoming_words=upcoming_words(diagnosis),
        empirical=" ".join(
            text
            for text in (empirical_sentence(diagnosis), curves_sentence(diagnosis), *extrapolation_sentences(diagnosis))
            if text
        ),
        smallest=limit_rows(diagnosis),
        follow_up=follow_up,
        confirm_sentence=confirm_sentence(confirm, unit) if confirm else "",
        seal=_seal(seal, final.get("parameters") or {}) if seal else None,
        seconds=diagnosis.get("seconds"),
        records=[{"title": f"{one.title}: {ROLES.get(one.role, one.role)}"} for one in records],
        records_style=records_style(),
        records_script=records_script(records) if records else "",
        shown=shown,
        folded=[i for i in range(len(records)) if i not in shown],
        picture_residual=as_svg(plot_residual(left)) if left else "",
        picture_answers=as_svg(plot_answers(asked, floor, words.searched_unit(diagnosis)))
        if any(len(q.get("window_rms") or {}) > 1 for _, q in asked)
        else "",
        picture_bars=as_svg(plot_residual_bars(logs, unit)) if logs else "",
        picture_candidates=as_svg(plot_candidates(scored, chosen)) if scored else "",
        picture_separations=as_svg(plot_separations(separation, (upcoming or {}).get("experiment")))
        if separation
        else "",
        pictures_found=[as_svg(plot_curve(c)) for c in found],
        pictures_open=[as_svg(plot_curve(c)) for c in others] if open_verdict else [],
        pictures_rest=[] if open_verdict else [as_svg(plot_curve(c)) for c in others],
    )


def _outcomes(candidates: Sequence[Mapping[str, Any]], chosen: Sequence[str]) -> list[tuple[str, str]]:
    """What became of the candidates, each outcome once, with the names that share it and their scores in percent."""
    found: dict[str, list[str]] = {}
    for one in candidates:
        outcome = "chosen" if one.get("effect") in chosen else str(one.get("rejected_because") or "not chosen")
        score = float(one.get("score") or 0.0)
        share = words.number(100.0 * score, 2) if score >= LEAST_SCORE else "0"
        found.setdefault(outcome, []).append(f"{words.effect_words(str(one.get('effect')))} {share} %")
    return [(outcome, ", ".join(names)) for outcome, names in found.items()]


LEAST_SCORE = 0.0005  # of a candidate in the picture: less is no bar


def _tests(diagnosis: Mapping[str, Any]) -> list[tuple[str, float, float]]:
    """Of every variable how much of the missing torque it explains, and how much chance would, in percent."""
    told = (diagnosis.get("residual") or {}).get("tests") or {}
    return [
        (words.FOLLOWS.get(key.removeprefix(TORQUE_TEST), key), 100.0 * value["r2"], 100.0 * value["chance_r2"])
        for key, value in told.items()
        if key.startswith(TORQUE_TEST) and isinstance(value, Mapping) and {"r2", "chance_r2"} <= set(value)
    ]


TORQUE_TEST = "missing_torque_"


def _value(value: Any) -> str:
    return words.effect_words(value) if isinstance(value, str) else words.number(value, 5)


def _seal(seal: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    """The opened seal: sentences, true against found parameters, and constants."""
    sentences = [f"Seed {seal['seed']}."] if "seed" in seal else []
    sentences += [
        f"{str(text)[0].upper()}{str(text)[1:]}.".replace("_", " ") for text in seal.get("truth") or [] if text
    ]
    compared = []
    for effect, told in (seal.get("reduced") or {}).items():
        for key, value in told.items():
            known = found.get(f"{effect}.{key}") or {}
            compared.append(
                {
                    "name": f"{words.effect_words(effect)}, {spoken(key)}",
                    "true": _value(_same_turn(value, key, known.get("value"))),
                    "found": _value(known.get("value")),
                    "interval": words.interval(known),
                    "unit": unit_words(str(known.get("unit") or "")),
                }
            )
    told_already = ("seed", "truth", "reduced", "effects" if seal.get("truth") else "")
    rest = flatten({key: value for key, value in seal.items() if key not in told_already})
    return {"sentences": sentences, "compared": compared, "rest": rest}


def _same_turn(true: Any, parameter: str, found: Any) -> Any:
    """A phase on the turn on which it was found: 206.6 and -153.4 degrees are one."""
    if "phase" not in parameter or not all(isinstance(value, (int, float)) for value in (true, found)):
        return true
    return true + 360.0 * round((found - true) / 360.0)


def confirm_sentence(confirm: Mapping[str, Any], unit: str) -> str:
    """What the fresh record says, in a sentence."""
    key = str(confirm.get("improvement_of", "free_run_rms"))
    before, after, floor = (words.error_of(confirm, stage, key) for stage in ("before", "after", "floor"))
    if before is None or after is None:
        return ""
    where = " in 1 s windows" if key == "window_rms" else ""
    level = f"; the floor is {words.with_unit(floor, unit)}" if floor is not None else ""
    gain = confirm.get("improvement_pct")
    if before == after:
        return f"On a fresh record the error{where} is {words.with_unit(before, unit)} rms{level}."
    change = f"from {words.with_unit(before, unit)} to {words.with_unit(after, unit)} rms"
    text = f"On a fresh record the error{where} went {change}"
    if isinstance(gain, (int, float)):
        bounds = words.interval(confirm, 3)
        text += f", {words.number(abs(gain), 3)} % {'less' if gain >= 0 else 'more'}"
        text += f" (95 % interval of the improvement: {bounds} %)" if bounds != words.DASH else ""
    return f"{text}{level}."


def flatten(value: Any, name: str = "") -> list[tuple[str, str]]:
    """Nested mappings and lists as rows of (dotted name, text)."""
    if isinstance(value, Mapping):
        return [row for key, item in value.items() for row in flatten(item, f"{name}.{key}" if name else str(key))]
    if isinstance(value, (list, tuple)) and any(isinstance(item, str) and " " in item for item in value):
        return [(name, _text(item)) for item in value]  # sentences
    if isinstance(value, (list, tuple)) and any(isinstance(item, (Mapping, list, tuple)) for item in value):
        return [row for i, item in enumerate(value, start=1) for row in flatten(item, f"{name}[{i}]")]
    if isinstance(value, (list, tuple)):
        return [(name, words.listed(_text(item) for item in value) or "none")]
    return [(name, _text(value))]


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return words.DASH
    return words.number(value, 5) if isinstance(value, (int, float)) else str(value)


def _stages(diagnosis: Mapping[str, Any]) -> Iterator[tuple[str, Any, str]]:
    """Rows of the before/after table: label, ``{"train": E, "holdout": E|null}``, kind."""
    yield str((diagnosis.get("declared") or {}).get("model", "declared model")), diagnosis.get("before"), "before"
    for step in diagnosis.get("steps") or []:
        yield f"+ {words.effect_words(str(step.get('effect')))}", step.get("after"), "after"
    yield "floor", diagnosis.get("floor"), "floor"
