"""What one-second windows say: how their whitened residuals pull at everything that may have changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fiohost.estimation.initial import has_own_zero, initial_guess, initial_state
from fiohost.estimation.predict import Flat, windowed
from fiohost.estimation.record import Record, cut_windows
from fiohost.estimation.tangent import Tangent
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.covariance import Movement
from fiohost.noise.estimate import Noise
from fiohost.noise.likelihood import Motor
from fiohost.noise.runs import varied
from fiohost.noise.whiten import Whitener
from fiohost.watch.candidates import Candidate, drifting

DRIFTS = 3


@dataclass(frozen=True)
class Window:
    """One window: the seconds it covers, information (k, k) and score (k) of all columns, the drifting three first;
    its whitened power and degrees of freedom, and the state (3) of what drifts around which it was looked at.
    """

    begin_s: float
    end_s: float
    information: np.ndarray = field(repr=False)
    score: np.ndarray = field(repr=False)
    power: float
    freedom: int
    around: np.ndarray


class Whitening:
    """Whitens windows of a motor as one that moves throughout: at rest that errs on the side of no alarm. What whitens
    windows of one length serves all of them.
    """

    def __init__(self, motor: Motor, noise: Noise) -> None:
        self.motor, self.noise = motor, noise
        self._known: dict[bytes, Whitener] = {}

    def apply(self, times_s: np.ndarray, series: np.ndarray) -> np.ndarray:
        """A window's series (n, k) at its times (n), whitened, without what its own start could take."""
        key = np.rint(np.diff(times_s) / self.motor.step_s * 20.0).astype(np.int32).tobytes()
        if key not in self._known:
            n = len(times_s)
            ends = (np.array([0]), np.array([n]))
            steady = Movement.steady(n, self.motor.tau_s)
            self._known[key] = Whitener(times_s, steady, np.ones(n), *ends, self.motor, self.noise)
        return self._known[key].apply(series)


def begin_of(record: Record, flat: Flat) -> Start:
    """How a piece of a run begins; from its first readings alone where nothing more is asked for."""
    if flat.gap or flat.warms or has_own_zero(record, flat):
        return initial_state(record, flat)
    angle, speed = initial_guess(record, record.y)
    return Start(angle, speed)


def evidence(
    record: Record, model: Model, around: np.ndarray, candidates: Sequence[Candidate], whitening: Whitening,
    offset_s: float = 0.0,
) -> list[Window]:  # fmt: skip
    """The windows of a record against a model that has drifted to ``around`` (3); ``candidates`` are its changes from
    there.
    """
    flat = Flat.of(varied(model, around))
    start = begin_of(record, flat)
    residual, begun = windowed(record, flat, start)
    tangent = Tangent(record, flat, start, begun)
    columns = [*drifting(model, around), *(column for c in candidates for column in c.columns)]
    by = np.column_stack([tangent.by(Flat.of(c.model), start, c.step) for c in columns])
    times, found = record.excitation.times_s, []
    for a, b, at in zip(*(ends.tolist() for ends in (*record.looked_at, record.edges[:-1])), strict=True):
        if times[b - 1] - times[a] < 0.5 or b - a < 8:
            continue  # too short to say anything beside its own start
        white = whitening.apply(times[a:b], np.column_stack((residual, by))[at : at + b - a])
        left, slopes = white[:, 0], white[:, 1:]
        begin, end = offset_s + float(times[a]), offset_s + float(times[b - 1]) + record.sample_time_s
        found.append(
            Window(begin, end, slopes.T @ slopes, slopes.T @ left, float(left @ left), b - a - 2, around.copy())
        )
    return found


def piece(record: Record, first: int, last: int, lead: int = 0) -> Record:
    """Rows ``first`` to ``last`` of a record, whose windows begin after ``lead`` rows more before them."""
    rows = slice(max(first - lead, 0), last)
    times, segments = record.excitation.times_s[rows], record.segments[rows]
    begin = first - rows.start
    return replace(
        record,
        excitation=replace(record.excitation, times_s=times),
        y=record.y[rows],
        segments=segments,
        weights=record.weights[rows],
        windows=begin + cut_windows(times[begin:], segments=segments[begin:]),
    )
