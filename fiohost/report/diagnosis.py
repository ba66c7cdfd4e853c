"""A diagnosis as things to draw: measured against simulated, before and after, for every log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fiohost.judging.followed import bench_angle
from fiohost.report.effect_curve import effect_curves
from fiohost.report.series import CurvePlot, SeriesPlot

if TYPE_CHECKING:
    from fiohost.advice.empirical import Empirical
    from fiohost.discover.diagnose import Diagnosis
    from fiohost.judging.followed import ForceCurve

TORQUE = "torque"
VARIABLE_LABELS = {
    "angle": "shaft angle in a turn (deg)",
    "speed": "speed ({length}/s)",
    "speed_sign": "direction of motion",
    "duty": "duty (%)",
    "time": "time (s)",
}


def series_of(found: Diagnosis) -> list[SeriesPlot]:
    """One picture a log, held-out ones first: they are the proof."""
    first, last = found.stages[0], found.stages[-1]
    held = zip(found.holdout, found.before_holdout, found.after_holdout, found.floor_holdout, strict=True)
    fitted = zip(found.logged, first.judgements, last.judgements, last.floors, strict=True)
    rows = [*(("holdout", *row) for row in held), *(("train", *row) for row in fitted)]
    return [
        SeriesPlot(
            title=record.name,
            role=role,
            unit=record.unit,
            time_s=record.excitation.times_s,
            measured=record.y - record.ahead_deg,
            before=before.simulated - record.ahead_deg,
            after=after.simulated - record.ahead_deg if found.steps else None,
            duty_pct=record.excitation.duties_pct[1:],
            floor_rms=floor.errors.free_run_rms,
            angle=bench_angle(record, after),
            quantum=record.quantum,
        )
        for role, record, before, after, floor in rows
    ]


def curves_of(found: Diagnosis) -> list[CurvePlot]:
    """Each found effect; the missing torque and what the named effects take up of it; then what the rest follows, if
    anything.
    """
    length = "deg" if found.train[0].rotary else "mm"
    named = [_force(c, found, length) for c in found.curves] if found.steps else []
    effects = effect_curves(found)
    if found.final.follows:
        return [*effects, *named]
    term = found.outlook.empirical
    return [
        *effects,
        *named,
        *([_empirical(term, VARIABLE_LABELS[term.variable].format(length=length))] if term else []),
        *_dependences(found, length),
    ]


def _force(curve: ForceCurve, found: Diagnosis, length: str) -> CurvePlot:
    """What the declared model lacks over a variable, what the named effects take up, and what is left."""
    x, lacked, left = curve.points.T
    names = ", ".join(s.effect.replace("_", " ") for s in found.steps)
    share = f"{curve.follows_pct:.0f} % of it, by chance {curve.by_chance_pct:.0f} %"
    return CurvePlot(
        title=f"Missing torque against {curve.variable}: {share}",
        x_label=VARIABLE_LABELS[curve.variable].format(length=length),
        y_label="missing torque (% of duty)",
        x=x,
        lines={names: lacked - left},
        points={"declared model lacks": (x, lacked), "left": (x, left)},
    )


def _empirical(term: Empirical, x_label: str) -> CurvePlot:
    """The empirical term, and by direction where its variable leaves that open."""
    quantity = "missing torque (% of duty)" if term.kind == TORQUE else f"error of measurement ({term.unit})"
    x, y = term.curve[:, 0], term.curve[:, 1]
    ways = {"forward": term.forward, "reverse": term.reverse}
    return CurvePlot(
        title=f"Empirical term: {100 * term.share_of_power:.0f} % of what remains, by chance "
        f"{100 * term.by_chance:.0f} %",
        x_label=x_label,
        y_label=quantity,
        x=x,
        lines={"empirical": y},
        band=(y - term.chance, y + term.chance),
        band_label="what chance can do to a point",
        points={name: (curve[:, 0], curve[:, 1]) for name, curve in ways.items() if len(curve)},
    )


def _dependences(found: Diagnosis, length: str) -> list[CurvePlot]:
    """Means of the missing torque over each variable that it follows."""
    return [
        CurvePlot(
            title=f"missing torque against {d.variable.replace('_', ' ')}: {100 * d.r2:.0f} % of it, "
            f"by chance {100 * d.chance_r2:.0f} %",
            x_label=VARIABLE_LABELS[d.variable].format(length=length),
            y_label="missing torque (% of duty)",
            x=np.asarray(d.centres, dtype=np.float64),
            lines={"mean in the bin": np.asarray(d.means, dtype=np.float64)},
        )
        for d in found.residual
        if d.significant
    ]
