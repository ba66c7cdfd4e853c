"""What all problems share: their numbers, the motor in them, and how an answer is put together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fiohost.labs.constants import MotorConstants
from fiohost.labs.problems.servo import FloatArray, Response, reached_s
from fiohost.labs.result import Answer, LabResult, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fiohost.report.panels import Panel

Numbers = Mapping[str, float]

MOTOR_KEYS = ("R_ohm", "L_H", "Kt_Nm_per_A", "Ke_Vs_per_rad", "J_kgm2", "B_Nms")
SHARES = (0.63, 0.75)


def motor_of(n: Numbers, **changes: float) -> MotorConstants:
    """The motor of a problem, some constants changed. Raises ConfigError for values out of range."""
    values = {key: n[key] for key in MOTOR_KEYS} | changes
    return MotorConstants(supply_V=5.0, source="control lab appendix, problem D-1", **values)


def solved(
    number: int,
    about: str,
    answers: Sequence[tuple[str, str]],
    values: Mapping[str, Any],
    panels: Callable[[], Sequence[Panel]] | None = None,
    tables: Sequence[Table] = (),
    notes: Sequence[str] = (),
) -> LabResult:
    """The result of one problem; *panels* draws its picture when it is asked for."""
    title = f"Problem D-{number}: {about}"

    def draw() -> Figure:
        from fiohost.report.panels import plot_panels

        assert panels is not None
        return plot_panels(panels(), title)

    return LabResult(
        name=f"D-{number}",
        title=title,
        target="computed",
        tables=tuple(tables),
        answers=tuple(Answer(question, answer) for question, answer in answers),
        notes=tuple(notes),
        values=values,
        figures={f"problem_D-{number}": draw} if panels else {},
    )


def in_s(time_s: float | None) -> str:
    return "never" if time_s is None else f"{time_s:.4g} s"


def rise_times(response: Response, y: FloatArray, final: float) -> tuple[float | None, float | None]:
    """When *y* reaches 63 and 75 % of its final value, from rest."""
    first, second = (reached_s(response.time_s, y, share * final) for share in SHARES)
    return first, second


def four_answers(run: Response, letters: str) -> tuple[list[tuple[str, str]], dict[str, Any]]:
    """Steady speed, 63 %, 75 % and largest current, which most problems ask for."""
    final = float(run.speed[-1])
    to_63, to_75 = rise_times(run, run.speed, final)
    asked = ("Steady speed", "63 % of it after", "75 % of it after", "Largest current")
    given = (f"{final:.4g} rad/s", in_s(to_63), in_s(to_75), f"{run.most_amps:.4g} A")
    marks = [f"({letter}) " if letter.strip() else "" for letter in letters]
    answers = [(mark + question, answer) for mark, question, answer in zip(marks, asked, given, strict=True)]
    values = {
        "steady_speed_rad_s": final,
        "to_63_pct_s": to_63,
        "to_75_pct_s": to_75,
        "largest_current_A": run.most_amps,
    }
    return answers, values


def change_by_load(run: Response, begin_s: float) -> dict[str, float | None]:
    """Speeds before and after a load, and times on both readings of what the text asks."""
    before, after = float(np.interp(begin_s, run.time_s, run.speed)), float(run.speed[-1])
    found: dict[str, float | None] = {"before_rad_s": before, "after_rad_s": after, "A": run.most_amps}
    for share in (63, 75):
        level = before + 0.01 * share * (after - before)
        changed = reached_s(run.time_s, run.speed, level, begin_s)
        found[f"up_{share}_s"] = reached_s(run.time_s, run.speed, 0.01 * share * after)
        found[f"change_{share}_s"] = None if changed is None else changed - begin_s
    return found


def speed_and_current(runs: Mapping[str, Response], until_s: float) -> Sequence[Panel]:
    """Speed and current of some runs over all the time that was asked for, and again their beginning up to a time."""
    from fiohost.report.panels import Curve, Panel

    whole_s = max(float(run.time_s[-1]) for run in runs.values())

    def curves(what: str, until_s: float) -> list[Curve]:
        kept = [(name, run, run.time_s <= until_s) for name, run in runs.items()]
        return [
            Curve(run.time_s[k], getattr(run, what)[k], name if what == "speed" else "", case=i, style="plain")
            for i, (name, run, k) in enumerate(kept)
        ]

    spans = [(whole_s, "")] if until_s > 0.5 * whole_s else [(whole_s, ""), (until_s, f", the first {until_s:.2g} s")]
    return [
        Panel(curves(what, span), label, title=f"{name}{told}")
        for span, told in spans
        for what, label, name in (("speed", "speed (rad/s)", "Speed"), ("amps", "current (A)", "Current"))
    ]


def angle_and_volts(runs: Mapping[str, Response], ref: float) -> Sequence[Panel]:
    """Two panels: angle and armature voltage of some runs."""
    from fiohost.report.panels import Curve, Panel

    asked = [Curve(run.time_s, 0.0 * run.time_s + ref, "asked for", -1, "reference") for run in [*runs.values()][:1]]
    angles = [Curve(run.time_s, run.angle, name, i, "plain") for i, (name, run) in enumerate(runs.items())]
    volts = [Curve(run.time_s, run.volts, "", i, "plain") for i, run in enumerate(runs.values())]
    return [Panel([*angles, *asked], "angle (rad)"), Panel(volts, "voltage (V)")]
