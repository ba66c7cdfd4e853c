"""Where to begin a fit: figures of responses jump, so what lies downhill of one start says little.

Of a candidate, sizes are tried around its trials, each with the rest of the model fitted to it; what stood in for the
effect is off without it. From the best of these everything is fitted. A declared model begins from a grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from fiohost.discover.tables.fit import Rows, TableFit, deviations, fit_tables, squares
from fiohost.discover.tables.settings import SETTINGS
from fiohost.discover.trials import Trial, varied
from fiohost.motor.effect import Effect, Span, Value
from fiohost.motor.model import Model


def spread(model: Model, keys: Sequence[str], points: int) -> list[Model]:
    """Copies of a model with the named numbers spread about their values, evenly (Roberts' R sequence)."""
    base = 2.0
    for _ in range(30):  # the only positive root of x**(d + 1) = x + 1
        base = (1.0 + base) ** (1.0 / (len(keys) + 1))
    steps = base ** -np.arange(1.0, len(keys) + 1.0)
    found = []
    for i in range(points):
        moved = model
        for key, at in zip(keys, (0.5 + i * steps) % 1.0, strict=True):
            moved = scaled(moved, [key], float(np.exp((2.0 * at - 1.0) * SETTINGS.spread)))
        found.append(moved)
    return found


def scaled(model: Model, keys: Sequence[str], times: float) -> Model:
    """A copy of a model with the named numbers so many ``times`` as large, within their bounds."""
    values: dict[str, Value] = {}
    for key in keys:
        parameter = model.parameter(key)
        values[key] = min(max(times * model.number(key), parameter.lower), parameter.upper)
    return model.with_values(values)


def _with_starts(item: Effect, trials: Sequence[Trial]) -> list[Trial]:
    """Trials in which a number that shapes the effect is zero, again with the value that the library starts from."""
    shapes = [q for q in item.parameters if q.is_smooth and q.neutral is None and q.start != 0.0]
    zero = [(t, [q for q in shapes if t.get(q.name) == 0.0]) for t in trials]
    return [{**t, **{q.name: q.start for q in found}} for t, found in zero if found]


def held(data: Rows, base: TableFit, item: Effect) -> list[TableFit]:
    """The base model with one effect added, the rest fitted to the sizes that it has, from its best trials; none where
    it leaves no trace.
    """
    tried = item.tried(Span((0.0, 0.0), (), full_deg_s=base.model.full_deg_s))
    given = [*tried, *_with_starts(item, tried)]
    trials = [base.model.with_effect(item.name, trial) for trial in given]
    before = np.concatenate(base.residuals)
    if max(np.abs(deviations(data, m, base.constants) - before).max() for m in trials) <= SETTINGS.trace:
        return []
    own = [f"{item.name}.{q.name}" for q in item.parameters]
    sizes = [k for k in trials[0].free() if k in own]

    def beside(model: Model) -> TableFit:
        fixed = replace(model, fixed=model.fixed | set(own))
        return fit_tables(data, fixed, constants=base.constants, evaluations=SETTINGS.held, derive=False)

    def best_around(model: Model) -> TableFit:
        more = spread(model, sizes, max(SETTINGS.points // len(trials), 1) - 1) if sizes else []
        found = min((beside(m) for m in (model, *more)), key=lambda f: f.cost)
        return replace(found, model=replace(found.model, fixed=model.fixed))

    found = [best_around(model) for model in trials]
    order = varied(item, [dict(t) for t in given], sorted(range(len(trials)), key=lambda i: found[i].cost))
    return [found[i] for i in order[: SETTINGS.best]]


def downhill(data: Rows, start: TableFit) -> TableFit:
    """A start followed down, then past the jump of single figures, then down again; the best of the way."""
    found = [start]
    for jumps in (0.0, SETTINGS.jump, 0.0):
        last = found[-1]
        found.append(
            fit_tables(
                data,
                last.model,
                constants=last.constants,
                evaluations=SETTINGS.all_free,
                jumps=jumps,
                derive=False,
            )
        )
    return min(found, key=lambda f: f.cost)


def to_the_end(data: Rows, near: TableFit) -> TableFit:
    """A fit carried to its minimum."""
    return fit_tables(data, near.model, constants=near.constants, looks=SETTINGS.looks)


def _grid(model: Model) -> list[Model]:
    """Copies of a model over all gains and lags, its other sizes smaller and larger together."""
    keys = ("linear.gain_deg_s_per_pct", "linear.tau_s")
    gains: Sequence[Value] = (
        np.geomspace(*SETTINGS.gains).tolist() if keys[0] not in model.fixed else [model.values[keys[0]]]
    )
    lags: Sequence[Value] = SETTINGS.lags_s if keys[1] not in model.fixed else [model.values[keys[1]]]
    others = [scaled(model, [k for k in model.free() if k not in keys], times) for times in SETTINGS.others]
    return [m.with_values({keys[0]: gain, keys[1]: lag}) for m, gain, lag in product(others, gains, lags)]


def _best_of(data: Rows, starts: Sequence[Model], constants: Sequence[Sequence[float]] | None) -> TableFit:
    """The best of fits from one start after the other, until one comes to the floor."""
    found: list[TableFit] = []
    for start in starts:
        near = downhill(data, fit_tables(data, start, constants=constants, evaluations=0, derive=False))
        found.append(to_the_end(data, near))
        if found[-1].cost <= SETTINGS.enough * data.samples:
            break
    return min(found, key=lambda f: f.cost)


def _closest(data: Rows, models: Sequence[Model], constants: Sequence[Sequence[float]]) -> list[Model]:
    return sorted(models, key=lambda m: squares(deviations(data, m, constants)))[: SETTINGS.starts]


def fit_declared(data: Rows, model: Model, *, keep_start: bool) -> TableFit:
    """Fit a declared model from scratch: from the best of a grid of its values.

    ``keep_start`` also begins with the model's own values, as when it was read from a file.
    """
    own = [model] if keep_start else []
    return _best_of(data, [*own, *_closest(data, _grid(model), data.known())], None)


def fit_anew(data: Rows, base: TableFit, item: Effect) -> TableFit:
    """The base model with one effect added, from a grid around what the library has in the place of the base's values:
    those of a model that fits nothing lead nowhere.
    """
    plain = base.model.with_values({key: base.model.parameter(key).start for key in base.model.free()})
    best = [_closest(data, _grid(plain.with_effect(item.name, trial)), base.constants) for trial in item.trials]
    ranked = [model for rank in zip(*best, strict=True) for model in _closest(data, rank, base.constants)]
    return _best_of(data, ranked[: SETTINGS.starts], base.constants)
