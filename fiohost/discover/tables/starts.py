"""Where to begin the fit of a candidate: figures of responses jump, so what lies downhill of one start says little.

Points are spread around the trials of the effect and the gain and lag of the base model, judged by a cost that cares
little for single figures far off (Cauchy's), and the best of them followed downhill under the same cost.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.discover.screen import varied
from fiohost.discover.tables.fit import Evidence, TableFit, deviations, fit_tables
from fiohost.motor.effect import Effect, Value
from fiohost.motor.model import Model

POINTS, BEST, EVALUATIONS = 120, 4, 8
# Logarithms of how far from its value a number may be; what stood in for the effect is off without it.
SPREAD = {"linear.gain_deg_s_per_pct": 0.3, "linear.tau_s": 0.4}
SPREAD_OF_TRIAL, CLOSE = 0.5, 0.2
JUMP_FLOORS = 5.0
TRACE_FLOORS = 1e-3


def cauchy(left: np.ndarray) -> float:
    """A cost (floors squared) in which a figure that jumped weighs little more than one that is some floors off."""
    return float(np.sum(np.log1p((left / JUMP_FLOORS) ** 2))) * JUMP_FLOORS**2


def spread(model: Model, keys: Sequence[str], points: int) -> list[Model]:
    """Copies of a model with the named numbers spread about their values, evenly (Roberts' R sequence).

    Every other one keeps close to the gain and lag that there are.
    """
    base = 2.0
    for _ in range(30):  # the only positive root of x**(d + 1) = x + 1
        base = (1.0 + base) ** (1.0 / (len(keys) + 1))
    steps = base ** -np.arange(1.0, len(keys) + 1.0)
    found = []
    for i in range(points):
        values: dict[str, Value] = {}
        for key, at in zip(keys, (0.5 + i * steps) % 1.0, strict=True):
            parameter = model.parameter(key)
            width = SPREAD[key] * (CLOSE if i % 2 else 1.0) if key in SPREAD else SPREAD_OF_TRIAL
            factor = np.exp((2.0 * at - 1.0) * width)
            values[key] = float(np.clip(model.number(key) * factor, parameter.lower, parameter.upper))
        found.append(model.with_values(values))
    return found


def begin(evidence: Evidence, base: TableFit, item: Effect) -> TableFit | None:
    """The base model with one effect added, near the best place to fit it from; None where it leaves no trace."""
    trials = [base.model.with_effect(item.name, trial) for trial in item.trials]

    def cost(model: Model) -> float:
        return cauchy(deviations(evidence, model, base.constants))

    before = np.concatenate(base.residuals)
    traces = [np.abs(deviations(evidence, m, base.constants) - before).max() for m in trials]
    if max(traces) <= TRACE_FLOORS:
        return None
    points: list[tuple[float, Model]] = []
    for model in trials:
        own = [f"{item.name}.{q.name}" for q in item.parameters if q.neutral is not None]
        keys = [k for k in (*SPREAD, *own) if k in model.free()]
        tried = [model, *(spread(model, keys, max(POINTS // len(trials), 1)) if keys else [])]
        points.append(min(((cost(m), m) for m in tried), key=lambda point: point[0]))
    order = varied(item, [dict(t) for t in item.trials], sorted(range(len(trials)), key=lambda i: points[i][0]))
    best = [points[i][1] for i in order[:BEST]]
    near = [fit_tables(evidence, m, constants=base.constants, evaluations=EVALUATIONS, jumps=JUMP_FLOORS) for m in best]
    return min(near, key=lambda f: cauchy(np.concatenate(f.residuals)))
