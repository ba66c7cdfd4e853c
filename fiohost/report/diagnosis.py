"""A diagnosis as things to draw: measured against simulated, before and after, for every log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fiohost.report.series import CurvePlot, SeriesPlot

if TYPE_CHECKING:
    from fiohost.discover.diagnose import Diagnosis

VARIABLE_LABELS = {
    "angle": "shaft angle in a turn (deg)",
    "speed": "speed ({length}/s)",
    "speed_sign": "direction of motion",
    "duty": "duty (%)",
    "time": "time (s)",
}


def series_of(found: Diagnosis) -> list[SeriesPlot]:
    """One picture a log, held-out ones first: they are the proof."""
    final, declared = found.final, found.declared
    held = zip(found.holdout, found.before_holdout, found.after_holdout, found.floor_holdout, strict=True)
    fitted = zip(found.train, declared.judgements, final.judgements, final.floors, strict=True)
    rows = [*(("holdout", *row) for row in held), *(("train", *row) for row in fitted)]
    return [
        SeriesPlot(
            title=record.name,
            role=role,
            unit=record.unit,
            time_s=record.excitation.times_s,
            measured=record.y,
            before=before.simulated,
            after=after.simulated if found.steps else None,
            duty_pct=record.excitation.duties_pct[1:],
            floor_rms=floor.errors.free_run_rms,
        )
        for role, record, before, after, floor in rows
    ]


def curves_of(found: Diagnosis) -> list[CurvePlot]:
    """What the remaining missing torque follows, where it follows anything."""
    if found.final.at_floor:
        return []
    length = "deg" if found.train[0].rotary else "m"
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
