"""Where to begin the fit of a candidate: figures of responses jump, so what lies downhill of one start says little.

Sizes of the effect are tried around its trials, each with the rest of the model fitted to it; what stood in for the
effect is off without it. From the best of these everything is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.screen import varied
from fiohost.discover.tables.fit import Rows, TableFit, deviations, fit_tables
from fiohost.motor.effect import Effect, Value
from fiohost.motor.model import Model

POINTS, BEST = 24, 2
HELD, FREE = 3, 8  # evaluations of a fit with the effect's sizes held, and of all
SPREAD = 0.5  # logarithm of how far from a trial a size may be
JUMP_FLOORS = 10.0
TRACE_FLOORS = 1e-3


def spread(model: Model, keys: Sequence[str], points: int) -> list[Model]:
    """Copies of a model with the named numbers spread about their values, evenly (Roberts' R sequence)."""
    base = 2.0
    for _ in range(30):  # the only positive root of x**(d + 1) = x + 1
        base = (1.0 + base) ** (1.0 / (len(keys) + 1))
    steps = base ** -np.arange(1.0, len(keys) + 1.0)
    found = []
    for i in range(points):
        values: dict[str, Value] = {}
        for key, at in zip(keys, (0.5 + i * steps) % 1.0, strict=True):
            parameter = model.parameter(key)
            size = model.number(key) * float(np.exp((2.0 * at - 1.0) * SPREAD))
            values[key] = min(max(size, parameter.lower), parameter.upper)
        found.append(model.with_values(values))
    return found


def _with_starts(item: Effect) -> list[dict[str, Value]]:
    """Trials in which a number that shapes the effect is zero, again with the value that the library starts from."""
    shapes = [q for q in item.parameters if q.is_smooth and q.neutral is None and q.start != 0.0]
    zero = [(t, [q for q in shapes if t.get(q.name) == 0.0]) for t in item.trials]
    return [{**t, **{q.name: q.start for q in found}} for t, found in zero if found]


def held(data: Rows, base: TableFit, item: Effect) -> list[TableFit]:
    """The base model with one effect added, the rest fitted to the sizes that it has, from its best trials; none where
    it leaves no trace.
    """
    given = [*item.trials, *_with_starts(item)]
    trials = [base.model.with_effect(item.name, trial) for trial in given]
    before = np.concatenate(base.residuals)
    if max(np.abs(deviations(data, m, base.constants) - before).max() for m in trials) <= TRACE_FLOORS:
        return []
    own = [f"{item.name}.{q.name}" for q in item.parameters]
    sizes = [k for k in trials[0].free() if k in own]

    def beside(model: Model) -> TableFit:
        fixed = replace(model, fixed=model.fixed | set(own))
        return fit_tables(data, fixed, constants=base.constants, evaluations=HELD, derive=False)

    def best_around(model: Model) -> TableFit:
        more = spread(model, sizes, max(POINTS // len(trials), 1) - 1) if sizes else []
        found = min((beside(m) for m in (model, *more)), key=lambda f: f.cost)
        return replace(found, model=replace(found.model, fixed=model.fixed))

    found = [best_around(model) for model in trials]
    order = varied(item, [dict(t) for t in given], sorted(range(len(trials)), key=lambda i: found[i].cost))
    return [found[i] for i in order[:BEST]]


def downhill(data: Rows, start: TableFit) -> TableFit:
    """A start followed down, then past the jump of single figures, then down again; the best of the way."""
    found = [start]
    for jumps in (0.0, JUMP_FLOORS, 0.0):
        last = found[-1]
        found.append(
            fit_tables(data, last.model, constants=last.constants, evaluations=FREE, jumps=jumps, derive=False)
        )
    return min(found, key=lambda f: f.cost)
