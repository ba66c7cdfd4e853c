"""Normal running, drawn: a motor whose gain, dry friction and load drift as random walks, through the same sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fiohost.estimation.predict import Flat, read
from fiohost.estimation.record import ANGLE, Record
from fiohost.judging.metrics import quantise
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start, run, run_loaded, start_state
from fiohost.noise.draw import draw_sensor, draw_torque
from fiohost.noise.estimate import Noise
from fiohost.noise.runs import varied

PIECE_S = 1.0


def walk(seconds: float, per_minute: tuple[float, float, float], rng: np.random.Generator) -> np.ndarray:
    """A random walk (pieces, 3) of what drifts, one row a second, from none."""
    n = int(np.ceil(seconds / PIECE_S)) + 1
    kicks = rng.standard_normal((n, 3)) * np.array(per_minute) * np.sqrt(PIECE_S / 60.0)
    kicks[0] = 0.0
    return np.asarray(np.cumsum(kicks, axis=0))


def drifting_run(
    record: Record, models: list[Model], start: Start, noise: Noise | None, rng: np.random.Generator
) -> np.ndarray:
    """What the sensor would have read (n) on a record's commands with one of ``models`` in each second after another;
    the last serves for all that follows.
    """
    times = record.excitation.times_s
    torque = draw_torque(times, noise, rng) if noise and noise.torque_pct.value > 0.0 else None
    edges = np.searchsorted(times, times[0] + PIECE_S * np.arange(1, len(models)) - 1e-9)
    edges = np.unique(np.concatenate(([0], np.minimum(edges, len(times) - 1), [len(times) - 1])))
    y = np.empty(len(times))
    state = None
    for i, (a, b) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        flat = Flat.of(models[min(i, len(models) - 1)])
        if state is None:
            state = start_state(start, flat.p, flat.on)
        how = record.excitation, flat.p, flat.on, flat.substep_s, state
        states = run(*how, a, b + 1) if torque is None else run_loaded(*how, -torque[a : b + 1], a, b + 1)
        state = states[-1].copy()
        part = replace(record.excitation, times_s=times[a : b + 1])
        y[a : b + 1] = read(replace(record, excitation=part), flat, states)
    if noise is not None and noise.sensor.value > 0.0:
        y = y + draw_sensor(len(y), noise, rng)
    if record.quantum > 0.0:
        y = quantise(record, y + (rng.uniform(0.0, 1.0) * record.quantum if record.kind == ANGLE else 0.0))
    return y


def normal_run(
    record: Record, model: Model, start: Start, noise: Noise, per_minute: tuple[float, float, float],
    rng: np.random.Generator, begin: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """One draw (n) of normal running on a record's commands, from ``begin`` (3) of what drifts."""
    path = walk(record.seconds, per_minute, rng) + (0.0 if begin is None else begin)
    return drifting_run(record, [varied(model, own) for own in path], start, noise, rng)
