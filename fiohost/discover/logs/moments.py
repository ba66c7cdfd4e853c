"""When something changed: the moment of an event that happened once, from one-second windows.

In windows an event spoils only those after it, and what each of them says of the parameters adds up: one pass over sums
finds the best moment between any two windows for each thing that may have changed. Whole runs, which carry every error
on, have a minimum at nearly every moment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.logs.offered import span_of
from fiohost.discover.settings import SETTINGS
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.predict import Flat, errors, squared
from fiohost.estimation.record import Record
from fiohost.motor.effect import Effect, Parameter
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start

MOMENTS = SETTINGS.moments


def moment_of(effect: Effect) -> Parameter | None:
    """The parameter that says when an event happened, if the effect is one."""
    return next((p for p in effect.parameters if p.is_searched), None) if effect.once else None


def unconfirmed_moment(found: Fit, of: Effect, records: Sequence[Record]) -> str | None:
    """Why an event that was fitted cannot be believed by when it happened, or None: of what holds before it or after it
    the records show less than any effect is asked for.
    """
    moment = moment_of(of)
    if moment is None:
        return None
    at = found.model.number(f"{of.name}.{moment.name}")
    spans = [(r.excitation.clock_s + r.excitation.times_s[[0, -1]]).tolist() for r in records]
    before = sum(max(min(at, last) - first, 0.0) for first, last in spans)
    least_s = min(before, sum(last - first for first, last in spans) - before)
    side = "before" if least_s == before else "after"
    return f"no more than {least_s:.2g} s of the logs are {side} it" if least_s < SETTINGS.score.block_s else None


def fit_event(base: Fit, effect: Effect, records: Sequence[Record]) -> Fit:
    """The base model with an event added: the best of those that windows suggest, whole runs fitted at the end.

    The moment stays where windows place it while the rest is fitted: by gradients it goes anywhere.
    """
    moment = moment_of(effect)
    assert moment is not None
    key = f"{effect.name}.{moment.name}"
    all_windows = [replace(r, every=1) for r in records]
    near = fit(base.model, all_windows, windows=True, max_iterations=12, tolerance=1e-3)
    found = [_held(m, key, all_windows) for m in _suggested(near, effect, moment, all_windows)]
    likely = sorted(found, key=lambda f: f.cost)[: MOMENTS.likely]
    best = min((_closer(f, key, all_windows) for f in likely), key=lambda f: f.cost)
    return fit(best.model, records, windows=base.windows, max_iterations=12, tolerance=1e-3)


def _closer(best: Fit, key: str, records: Sequence[Record]) -> Fit:
    """Windows fitted with the moment where it is, then with the moment where they fit best, ever closer."""
    reach = MOMENTS.reach_s
    for _ in range(MOMENTS.rounds):
        parameter, centre = best.model.parameter(key), best.model.number(key)
        places = np.clip(centre + reach * np.linspace(-1.0, 1.0, MOMENTS.looks), parameter.lower, parameter.upper)
        models = [best.model.with_values({key: float(t)}) for t in places]
        near = [(_around(r, centre, reach), s) for r, s in zip(records, best.starts, strict=True)]
        costs = [sum(_window_cost(m, s, r) for r, s in near if r is not None) for m in models]
        best = min((best, _held(models[int(np.argmin(costs))], key, records)), key=lambda f: f.cost)
        reach /= MOMENTS.closer
    return best


def _around(record: Record, moment_s: float, reach_s: float) -> Record | None:
    """A record with only those windows that a moment so near can reach, or None where it has none."""
    edges = record.windows
    times = np.append(record.excitation.times_s, np.inf)[edges] + record.excitation.clock_s
    near = np.flatnonzero((times[1:] >= moment_s - reach_s) & (times[:-1] <= moment_s + reach_s))
    return replace(record, windows=edges[near[0] : near[-1] + 2]) if len(near) else None


def _held(model: Model, key: str, records: Sequence[Record]) -> Fit:
    held = replace(model, fixed=model.fixed | {key})
    found = fit(held, records, windows=True, max_iterations=12, tolerance=1e-3)
    return replace(found, model=replace(found.model, fixed=model.fixed))


def _windows_of(model: Model, like: Fit, records: Sequence[Record]) -> list[np.ndarray]:
    flat = Flat.of(model)
    return [errors(r, flat, s, windows=True) for r, s in zip(records, like.starts, strict=True)]


def _window_cost(model: Model, start: Start, record: Record) -> float:
    return squared([errors(record, Flat.of(model), start, windows=True)])


def _suggested(near: Fit, effect: Effect, moment: Parameter, records: Sequence[Record]) -> list[Model]:
    """For each thing that may have changed, the model with the moment and size that explain most of what windows leave.

    ``near`` is fitted to windows. The change is linear in its size, as for a small one.
    """
    ratio = next(p for p in effect.parameters if p.neutral is not None)
    choice = next(p for p in effect.parameters if p.is_choice)
    begin = span_of(records).time_s[0]
    before = _windows_of(near.model, near, records)  # as those after: a fit knows better where its windows begin
    changes = []
    for which in choice.choices:
        changed = near.model.with_effect(
            effect.name, {moment.name: begin, choice.name: which, ratio.name: 1.0 + MOMENTS.small_change}
        )
        after = _windows_of(changed, near, records)
        changes.append([(a - b) / MOMENTS.small_change for a, b in zip(before, after, strict=True)])
    own = len(near.names)
    times: list[float] = []
    grams: list[np.ndarray] = []
    for i, record in enumerate(records):
        columns = np.column_stack([near.jacobians[i], *(c[i] for c in changes), before[i]])
        for a, b in zip(record.windows[:-1], record.windows[1:], strict=True):
            times.append(record.excitation.clock_s + float(record.excitation.times_s[a]))
            grams.append(columns[a:b].T @ columns[a:b])
    order = np.argsort(times)
    since = np.cumsum(np.array(grams)[order][::-1], axis=0)[::-1]
    models = []
    for n, which in enumerate(choice.choices):
        gains = [_explained(since[0], later, own, own + n) for later in since]
        best = int(np.argmax([gain for gain, _ in gains]))
        size = float(np.clip(1.0 + gains[best][1], MOMENTS.least_ratio, MOMENTS.most_ratio))
        trial = {moment.name: times[order[best]], choice.name: which, ratio.name: size}
        models.append(near.model.with_effect(effect.name, trial))
    return models


def _explained(all_sums: np.ndarray, later: np.ndarray, own: int, column: int) -> tuple[float, float]:
    """What a change from some window on explains of the squared error, and its size, the model's ``own`` parameters
    fitted with it; sums of products (k, k) over all windows and over those from that one on, the error's last.
    """
    normal = np.empty((own + 1, own + 1))
    normal[:own, :own] = all_sums[:own, :own]
    normal[:own, own] = normal[own, :own] = later[:own, column]
    normal[own, own] = later[column, column]
    right = np.append(all_sums[:own, -1], later[column, -1])
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    step = np.linalg.lstsq(normal / np.outer(scale, scale), right / scale, rcond=1e-9)[0] / scale
    return float(right @ step), float(step[own])
