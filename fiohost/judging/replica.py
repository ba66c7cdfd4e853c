"""Replicas: what the sensor would have read had a fitted model been true, with the noise that a record has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from fiohost.estimation.predict import Begun, Flat, free_output, read, turned_deg, windowed
from fiohost.estimation.record import ANGLE, MEAN_SPEED, Record
from fiohost.judging.metrics import quantise
from fiohost.judging.settings import FLOOR
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start, run_loaded, start_state
from fiohost.motor.state import LOAD_THETA, THETA
from fiohost.noise.draw import draw_sensor, draw_torque
from fiohost.noise.estimate import Noise
from fiohost.noise.runs import run_of, varied


def within_count(record: Record, residual: np.ndarray) -> tuple[float, float]:
    """Bounds of how far the shaft may stand from the model's angle, from the residual (n) of its free run.

    Every reading bounds it to one count, so a model that is true leaves little room (set membership): taken is where
    the fewest readings contradict. Those of a closed loop hunt for an edge between two counts, which no angle drawn at
    random would do. Where the model is too far off to say, any angle within the count is possible.
    """
    count = record.quantum
    if float(np.ptp(residual)) > (1.0 + 2.0 * FLOOR.lost_counts) * count:
        return -0.5 * count, 0.5 * count
    above, below = np.sort(residual - 0.5 * count), np.sort(residual + 0.5 * count)
    # Between two neighbouring bounds the number of readings that contradict does not change.
    edges = np.unique(np.concatenate((above, below)))
    middles = 0.5 * (edges[:-1] + edges[1:])
    against = len(above) - np.searchsorted(above, middles) + np.searchsorted(below, middles)
    best = int(np.argmin(against)) if len(middles) else 0
    middle = float(middles[best]) if len(middles) else float(edges[0])
    room = 0.5 * float(edges[best + 1] - edges[best]) if len(middles) else 0.0
    return middle - room, middle + room


class Replicas:
    """Draws of what the sensor would have read of a record had a model been true, begun at a start.

    The angle within its count is unknown, but for what the ``residual`` (n) of the model's free run says of it. What
    all draws have in common is worked out once.
    """

    def __init__(self, record: Record, model: Model, start: Start, residual: np.ndarray | None = None) -> None:
        self.record, self.model, self.start = record, model, start
        self.flat = Flat.of(model)
        self._within = within_count(record, residual) if residual is not None and record.kind == ANGLE else None

    @cached_property
    def truth(self) -> np.ndarray:
        """The output (n) of the model's free run from the start."""
        return free_output(self.record, self.flat, self.start)

    @cached_property
    def begun(self) -> Begun:
        """Where windows of that output begin."""
        return windowed(self.record, self.flat, self.start, self.truth)[1]

    def draw(self, rng: np.random.Generator, day: Record | None = None) -> np.ndarray:
        """One draw (n); of the record as another ``day`` gives it."""
        record, model = day or self.record, self.model
        noise, own = (record.disturbance.noise, record.disturbance.own) if record.disturbance else (None, None)
        if noise and noise.runs.known:
            model = varied(model, own.values if own else noise.runs.about_model * rng.standard_normal(3))
        shift = self._shift(rng) if record.kind == ANGLE else 0.0
        begin = self.start._replace(angle=self.start.angle + shift)
        if noise and noise.torque_pct.value > 0.0:
            truth = disturbed_output(record, model, begin, noise, rng)
        elif model is self.model and not (self.flat.bends and shift):
            truth = self.truth + shift
        else:
            truth = free_output(record, Flat.of(model), begin)
        average, shown = record.average, truth
        if average:
            record = replace(record, kind=MEAN_SPEED, quantum=average.quantum)
            truth = average.undone(truth, np.zeros(1, dtype=np.int64))
        if noise and noise.sensor.value > 0.0:
            truth = truth + draw_sensor(len(truth), noise, rng)
        if record.kind == ANGLE:
            return quantise(record, truth + 0.5 * record.quantum)
        if record.kind == MEAN_SPEED:
            truth[0] += rng.uniform(0.0, 1.0) * record.quantum  # where within its count the shaft stood
        read = quantise(record, truth)
        return average.of(read, float(shown[0])) if average else read

    def left(self, rng: np.random.Generator, windows: bool, day: Record | None = None) -> np.ndarray:
        """What the model leaves (n) of a draw as a fit weighs it, in whole or in one-second ``windows``."""
        record, y = day or self.record, self.draw(rng, day)
        if windows:
            return windowed(record, self.flat, self.start, y, near=self.begun)[0]
        return np.asarray(record.weights * (y - self.truth))

    def _shift(self, rng: np.random.Generator) -> float:
        """Where within its count the shaft stood, one draw; how well a fitted model knows it is drawn too."""
        if self._within is None:
            return float(rng.uniform(-0.5, 0.5)) * self.record.quantum
        low, high = self._within
        least = self.record.quantum * float(np.exp(rng.uniform(*np.log(FLOOR.least_room_counts))))
        return 0.5 * (low + high) + float(rng.uniform(-1.0, 1.0)) * max(0.5 * (high - low), least)


def another_day(
    records: Sequence[Record], rng: np.random.Generator, *, open_noise: bool = True, open_runs: bool = False
) -> list[Record]:
    """The records as another day would give them: what is each run's own is drawn anew, and the noise is what it may
    be, as far as the data leave that open; the likeliest where it is not an ``open_noise``. With ``open_runs`` so does
    how much runs scatter.
    """
    if all(r.disturbance is None for r in records):
        return list(records)
    drawn: dict[str, np.ndarray] = {}
    found, u = [], float(rng.random())
    runs = next(r.disturbance.noise.runs for r in records if r.disturbance is not None)
    sd = runs.likely_sd(rng) if open_runs else runs.about_model
    for record in records:
        disturbance = record.disturbance
        if disturbance is not None:
            own = disturbance.own
            if own is not None:
                own = replace(own, values=drawn.setdefault(run_of(record.name), sd * rng.standard_normal(len(sd))))
            noise = disturbance.noise.drawn(u) if open_noise else disturbance.noise
            record = replace(record, disturbance=replace(disturbance, noise=noise, own=own))
        found.append(record)
    return found


def disturbed_output(record: Record, model: Model, start: Start, noise: Noise, rng: np.random.Generator) -> np.ndarray:
    """The output (n) of a free run under a random torque, held from each sample to the next."""
    flat = Flat.of(model).from_zero(start.zero)
    turned = turned_deg(record, flat)
    begin = start_state(start._replace(angle=start.angle + turned), flat.p, flat.on)
    torque = draw_torque(record.excitation.times_s, noise, rng)
    states = run_loaded(record.excitation, flat.p, flat.on, flat.substep_s, begin, -torque)
    states[:, [THETA, LOAD_THETA]] -= turned
    return read(record, flat, states)
