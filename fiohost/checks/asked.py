"""A question asked of logs: pieces of them, the model refitted under each answer, and which answer is believed.

An answer against a statement is believed where it leaves the counts alone, or takes away most of the error, and no
ordinary explanation fitted to the same pieces does so too. Errors are those of one-second windows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.predict import Flat, free_states, read, window_residuals
from fiohost.estimation.record import SHORTEST, Record, cut_windows
from fiohost.judging.metrics import quantise
from fiohost.motor.model import Model

PIECE_S, PIECES = 4.0, 10
# Most iterations of a fit and the gain at which it stops.
ROUGH, FIRST, NEXT = (2, 1e-2), (15, 1e-3), (8, 1e-4)
BELIEVED = ("contradicted", "suspected")
# Window errors over their floor: so close it is reached; so much worse a statement may be contradicted; so much better
# is beyond chance where the floor is far.
REACHED, WORSE, MUCH_BETTER = 1.1, 1.2, 3.0
# Standard errors by which an answer must beat another explanation: to be told of, and to be sure.
PERHAPS, SURE = 1.0, 3.0


@dataclass(frozen=True)
class Question:
    """One question with the window error of each answer, in the output's unit.

    ``verdict`` is ``as_said``, ``contradicted`` (beyond doubt), ``suspected``, ``open`` or ``not_asked``; ``sentence``
    says it for people. ``estimate`` is a delay in ticks with its 95 % interval, where one was fitted freely.
    """

    name: str
    said: str
    verdict: str
    sentence: str
    window_rms: Mapping[str, float] = field(default_factory=dict)
    best: str | None = None
    estimate: tuple[float, float, float] | None = None

    @property
    def warns(self) -> bool:
        return self.verdict in BELIEVED

    def to_json(self) -> dict[str, object]:
        estimate = self.estimate
        return {
            "said": self.said,
            "best": self.best,
            "verdict": self.verdict,
            "sentence": self.sentence,
            "window_rms": dict(self.window_rms),
            "estimate": {"value": estimate[0], "ci95": list(estimate[1:])} if estimate else None,
        }


def _piece(record: Record, a: int, b: int) -> Record:
    """Samples ``a`` to ``b`` of a record with all its commands, so that what acted before them is known."""
    times = record.excitation.times_s[a:b]
    return replace(
        record,
        excitation=replace(record.excitation, times_s=times),
        y=record.y[a:b],
        at_rest=False,
        segments=record.segments[a:b],
        windows=cut_windows(times, segments=record.segments[a:b]),
    )


def pieces(records: Sequence[Record], count: int = PIECES, length_s: float = PIECE_S) -> list[Record]:
    """Pieces of the logs in which commands change most, from as many logs as there are."""
    offered: list[tuple[float, int, Record]] = []
    for record in records:
        times, duty = record.excitation.times_s, record.excitation.duties_pct[1:]
        edges = cut_windows(times, length_s)
        change = np.abs(np.diff(duty, prepend=duty[0]))
        scores = [(float(change[a:b].sum()), a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]
        best = sorted((s for s in scores if s[2] - s[1] >= SHORTEST), key=lambda s: s[0], reverse=True)
        offered += [(score, rank, _piece(record, a, b)) for rank, (score, a, b) in enumerate(best)]
    # The best of every log before the second of any.
    offered.sort(key=lambda o: (o[1], -o[0]))
    return [piece for _, _, piece in offered[:count]]


def shifted(record: Record, ticks: float) -> Record:
    """The record with its commands acting so many ticks later than it says."""
    ex = record.excitation
    return replace(record, excitation=replace(ex, act_times_s=ex.act_times_s + ticks * record.sample_time_s))


def at_zero(record: Record, mode: int) -> Record:
    """The record with every command of zero duty in one mode."""
    ex = record.excitation
    return replace(record, excitation=replace(ex, modes=np.where(ex.duties_pct == 0.0, mode, ex.modes)))


def floor_of(found: Fit, parts: Sequence[Record]) -> float | None:
    """Window error of data that the fitted model itself would give through the same sensor."""
    if any(p.quantum <= 0 for p in parts):
        return None
    total, samples = 0.0, 0
    for part, start in zip(parts, found.starts, strict=True):
        flat = Flat.of(found.model).from_zero(start.zero)
        states = free_states(part, flat, start)
        left = window_residuals(part, flat, states, quantise(part, read(part, flat, states) + 0.37 * part.quantum))
        total, samples = total + float(left @ left), samples + len(left)
    return float(np.sqrt(total / samples))


@dataclass(frozen=True)
class Asked:
    """What is common to all questions: the pieces, the declared model fitted to them as the logs say, their floor."""

    records: Sequence[Record]
    parts: Sequence[Record]
    guess: Model
    base: Fit
    floor: float | None

    def refit(self, model: Model, change: Callable[[Record], Record] = lambda r: r) -> Fit:
        return fit_windows(model, [change(p) for p in self.parts], NEXT)

    def reached(self, rms: float) -> bool:
        return self.floor is not None and rms <= REACHED * self.floor

    def believed(self, said: Fit, answer: Fit, rivals: Sequence[Fit] = ()) -> str:
        """The verdict on an answer against a statement, beside ordinary explanations fitted to the same pieces."""
        if self.reached(said.rms) or answer.rms * WORSE > said.rms:
            return "as_said" if self.reached(said.rms) else "open"
        margin = min((self._margin(answer, r) for r in rivals), default=np.inf)
        if margin < PERHAPS:
            return "open"
        if self.reached(answer.rms):
            return "contradicted" if margin > SURE else "suspected"
        return "suspected" if answer.rms * MUCH_BETTER <= said.rms else "open"

    def _margin(self, answer: Fit, rival: Fit) -> float:
        """By how many standard errors of the windows an answer beats a rival; infinite where it is plain to see."""
        if rival.rms > WORSE * answer.rms:
            return float(np.inf)
        gains = np.concatenate(
            [
                np.add.reduceat(r**2 - a**2, p.windows[:-1])
                for a, r, p in zip(answer.residuals, rival.residuals, self.parts, strict=True)
            ]
        )
        return float(gains.sum() / max(gains.std() * np.sqrt(len(gains)), 1e-300))


def fit_windows(model: Model, parts: Sequence[Record], effort: tuple[int, float]) -> Fit:
    return fit(model, parts, windows=True, max_iterations=effort[0], tolerance=effort[1])
