"""Curves of no name in the model that is handed over where something stays unexplained.

Load and friction over the position are linear in the points of their curves, so that a fit always finds them. They are
taken where left-out records gain by them; they name nothing, and the verdict stays what it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.discover.logs.left_out import left_out
from fiohost.discover.logs.weighed_windows import WeighedWindows
from fiohost.discover.score import Gain
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.record import ANGLE, Record
from fiohost.motor.model import Model

CURVES = ("friction_over_position", "load_over_position")
POINTS_DRAWN = 12


@dataclass(frozen=True)
class Unnamed:
    """A model with curves of no name, and what windows of the training records leave without and with them, in the
    output's unit.
    """

    model: Model
    effects: tuple[str, ...]
    before_rms: float
    after_rms: float

    def to_json(self) -> dict[str, object]:
        return {
            "effects": list(self.effects),
            "before": {"window_rms": self.before_rms},
            "after": {"window_rms": self.after_rms},
            "curves": [{"effect": name, "unit": "%", **_curve(self.model, name)} for name in self.effects],
        }


def _curve(model: Model, name: str) -> dict[str, object]:
    """The points of a curve: positions on the axis, and torques in percent of duty, the last closing the sum."""
    keys = [key for key in model.values if key.startswith(f"{name}.point_")]
    values = [model.number(key) for key in keys]
    values.append(-float(np.sum(values)))
    begin, span = model.number(f"{name}.from_deg"), model.number(f"{name}.span_deg")
    at = [begin + span * i / len(values) for i in range(len(values))]
    return {
        "position_unit": model.unit,
        "from": begin,
        "span": span,
        "points": [list(pair) for pair in zip(at, values, strict=True)],
    }


def with_curves(model: Model, train: Sequence[Record]) -> Unnamed | None:
    """The model with what left-out records ask for of the curves over position; None where they ask for none."""
    if not all(r.kind == ANGLE or r.rotary for r in train):
        return None
    windows = WeighedWindows(train)
    records = windows.plain
    base = fit(model, records, windows=True, max_iterations=12, tolerance=1e-5)
    first, taken = base, []
    names = [n for n in CURVES if n not in model.effects]
    while names:
        tried = {n: _with(base, n, records) for n in names}
        best = min(names, key=lambda n: tried[n].cost)
        variance = tried[best].cost / max(tried[best].samples, 1.0)
        before, after = (left_out(found, variance, records, windows.groups) for found in (base, tried[best]))
        gain = Gain.of(before, after)
        if not gain.sure() or gain.total <= 0.0:
            break
        base = tried[best]
        taken.append(best)
        names.remove(best)
    return Unnamed(base.model, tuple(taken), first.rms, base.rms) if taken else None


def _with(base: Fit, name: str, records: Sequence[Record]) -> Fit:
    """A fit with one more curve, laid over a turn or over the travel."""
    if records[0].rotary:
        begin, span = 0.0, 360.0
    else:  # the curve closes behind the travel, where nobody goes
        begin = min(float(r.y.min()) for r in records)
        reach = max(float(r.y.max()) for r in records) - begin
        span = max(reach * POINTS_DRAWN / (POINTS_DRAWN - 1), 0.1)
    model = base.model.with_effect(name, {"from_deg": begin, "span_deg": span})
    return fit(model, records, windows=True, starts=base.starts, max_iterations=12, tolerance=1e-5)
