"""When windows stop agreeing with a model: a window-limited generalised likelihood ratio for each candidate.

What drifts in normal running (gain, dry friction, load) is followed by a Kalman filter over random walks. Looking back
over some windows, a candidate's size is estimated by least squares from the windows' whitened residuals, the drift
before and within them marginalised; the statistic is the square of its estimate in standard deviations (Willsky and
Jones 1976; Lai 1998). ``spread`` says how much wider than chi-squared it is in replicas of normal running.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import log_ndtr

from fiohost.watch.candidates import Candidate
from fiohost.watch.evidence import DRIFTS, Window
from fiohost.watch.settings import SETTINGS, WatchSettings

UNEXPLAINED = "unexplained"
# Of one window's surplus of power no more is believed than this, in standard deviations: a start of the shaft a
# moment sooner or later is a surplus, and no change.
CLIPPED = (-2.0, 3.0)
# Once more is seen, the beginning of a change is looked for within so many windows of where the alarm had it.
NEAR_WINDOWS = 2
DRIFT_NAMES = (
    ("parameter_change", "gain", "share"),
    ("parameter_change", "friction", "share"),
    ("constant_load", "", "% duty"),
)


@dataclass(frozen=True)
class Normal:
    """What is normal: the model's drifting three (3) and their covariance (3, 3), a window's power by its degrees of
    freedom, and the spread (candidates + 1, lengths) of the statistics against their distribution. ``lacks`` (k) is
    what the model lacks of the motor even then, in the columns' units (none of the three that drift), ``unsure``
    (k - 3, k - 3) the covariance of it, the drift apart.
    """

    at: np.ndarray
    covariance: np.ndarray
    power: float
    spread: np.ndarray = field(repr=False)
    lacks: np.ndarray = field(repr=False)
    unsure: np.ndarray = field(repr=False)

    def corrected(self, window: Window) -> Window:
        """A window as a model that lacks nothing of the normal motor would leave it, to first order."""
        pulled = window.information @ self.lacks
        power = window.power - float(self.lacks @ (2.0 * window.score - pulled))
        return replace(window, score=window.score - pulled, power=max(power, 0.0))


@dataclass(frozen=True)
class Named:
    """A candidate that may be behind a change: its share of the belief, and its size with a 95 % interval."""

    effect: str
    what: str
    share: float
    size: float
    ci95: tuple[float, float]
    unit: str

    def to_json(self) -> dict[str, Any]:
        return {"effect": self.effect, "what": self.what, "probability": self.share, "size": self.size,
                "ci95": list(self.ci95), "unit": self.unit}  # fmt: skip


@dataclass(frozen=True)
class Event:
    """``kind``: alarm, named (the alarm some windows later), over, drifted. Times in s of the log; ``surprise`` is -ln
    of the chance of as much in normal running, ``false_alarms_per_day`` what an alarm set there would give.
    """

    kind: str
    time_s: float
    since_s: float
    since_ci95_s: tuple[float, float]
    surprise: float
    false_alarms_per_day: float
    causes: tuple[Named, ...]

    @property
    def effect(self) -> str:
        return self.causes[0].effect if self.causes else UNEXPLAINED

    def to_json(self) -> dict[str, Any]:
        return {"kind": self.kind, "time_s": self.time_s, "since_s": self.since_s,
                "since_ci95_s": list(self.since_ci95_s), "effect": self.effect, "surprise": self.surprise,
                "false_alarms_per_day": self.false_alarms_per_day,
                "causes": [c.to_json() for c in self.causes]}  # fmt: skip


@dataclass(frozen=True)
class _Past:
    """A window, what was believed of the drift before it, its weight, and its power beside that drift."""

    window: Window
    at: np.ndarray
    covariance: np.ndarray
    weight: float
    power: float


@dataclass(frozen=True)
class Looks:
    """Statistics over several lengths (l): ``squares`` of the candidates (l, c) without the one window that says most,
    scores (l, k) and information (l, k, k) of all columns, ``surplus`` (l) of the power over what is normal, what drift
    takes of it (l), and ``power`` (l), how far windows stand above what is normal, none counting for much.
    """

    squares: np.ndarray
    score: np.ndarray
    information: np.ndarray
    surplus: np.ndarray
    taken: np.ndarray
    power: np.ndarray


class Detector:
    """Takes windows one after another; ``push`` gives what there is to say after each."""

    def __init__(self, candidates: Sequence[Candidate], normal: Normal, settings: WatchSettings = SETTINGS) -> None:
        self.candidates, self.normal, self.settings = tuple(candidates), normal, settings
        self.at, self.covariance = normal.at.copy(), normal.covariance.copy()
        self._walk = np.diag(np.square(settings.drift_per_minute)) / 60.0
        self._past: deque[_Past] = deque(maxlen=max(settings.lengths))
        self._alarmed: Event | None = None
        self._quiet = self._since_alarm = 0
        self._drifted = np.zeros(DRIFTS, dtype=bool)
        ends = np.cumsum([len(c.columns) for c in self.candidates])
        self._slices = [slice(e - len(c.columns), e) for e, c in zip(ends.tolist(), self.candidates, strict=True)]
        self.freedoms = np.array([len(c.columns) for c in self.candidates])

    @property
    def threshold(self) -> float:
        """The surprise that an alarm asks for."""
        tries = self.settings.false_alarm_h * 3600.0 * (len(self.candidates) + 1)
        return float(np.log(tries * self.settings.tail_margin))

    @property
    def windows(self) -> int:
        """How many windows can be looked back on."""
        return len(self._past)

    @property
    def alarmed(self) -> bool:
        return self._alarmed is not None

    def push(self, window: Window) -> list[Event]:
        """One more window: what there is to say after it, most often nothing."""
        self.follow(window)
        if len(self._past) < min(self.settings.lengths):
            return []
        looks = self.looks()
        surprises = self.surprises(looks)
        if self._alarmed is not None:
            return self._while_alarmed(window, surprises)
        if float(surprises.max()) <= self.threshold:
            return self._slow(window)
        event = self._event("alarm", window, surprises)
        self._alarmed, self._quiet, self._since_alarm = event, 0, 0
        before = next((p for p in self._past if p.window.begin_s >= event.since_s), self._past[0])
        self.at, self.covariance = before.at.copy(), before.covariance.copy()  # the change is no drift
        return [event]

    def follow(self, window: Window) -> None:
        """Take a window in without judging it."""
        window = self.normal.corrected(window)
        seconds, normal = window.end_s - window.begin_s, self.normal.power
        self.covariance = self.covariance + self._walk * seconds
        off = self.at - window.around
        power = window.power - 2.0 * float(off @ window.score[:DRIFTS])
        power += float(off @ window.information[:DRIFTS, :DRIFTS] @ off)
        most = self.settings.most_power * normal * window.freedom
        weight = min(1.0, most / max(power, 1e-300)) / normal
        self._past.append(_Past(window, self.at.copy(), self.covariance.copy(), weight, power))
        if self._alarmed is not None:
            return
        information = window.information[:DRIFTS, :DRIFTS] * weight
        score = window.score[:DRIFTS] * weight - information @ off
        # One window moves the filter no further than chance would: a start a moment sooner is no drift (Huber 1964).
        expected = information + information @ self.covariance @ information
        far = float(np.sqrt(max(score @ np.linalg.pinv(expected, hermitian=True) @ score, 0.0)))
        trust = min(1.0, self.settings.most_sigmas / max(far, 1e-300))
        information, score = information * trust, score * trust
        self.covariance = np.linalg.inv(np.linalg.inv(self.covariance) + information)
        self.at = self.at + self.covariance @ score

    def looks(self, lengths: Sequence[int] | None = None) -> Looks:
        """Statistics over the lengths (of the settings) for which there are windows enough."""
        lengths = [n for n in lengths or self.settings.lengths if n <= len(self._past)]
        past, many = list(self._past), len(self._past)
        places = np.arange(many)
        inside = np.array([places >= many - n for n in lengths], dtype=np.float64)  # (l, w)
        along = np.array([(places - (many - n) + 0.5) / n for n in lengths])
        weights = np.array([p.weight for p in past])
        gram = np.array([p.window.information for p in past]) * weights[:, None, None]
        around = np.array([p.window.around for p in past])
        pulls = np.array([p.window.score for p in past]) * weights[:, None]
        columns = gram.shape[1]
        flat = gram.reshape(many, -1)
        d, c = slice(0, DRIFTS), slice(DRIFTS, None)

        def total(by: np.ndarray) -> np.ndarray:
            return np.asarray(by @ flat).reshape(len(lengths), columns, columns)

        level, tilted, twice = total(inside), total(inside * along), total(inside * along**2)
        firsts = [many - n for n in lengths]
        at = np.array([past[i].at for i in firsts])
        ends = past[-1].window.end_s
        prior = np.linalg.inv(self.settings.prior_widening * np.array([past[i].covariance for i in firsts]))
        known = np.empty((len(lengths), 2 * DRIFTS, 2 * DRIFTS))
        known[:, :DRIFTS, :DRIFTS] = level[:, d, d] + prior
        known[:, :DRIFTS, DRIFTS:] = known[:, DRIFTS:, :DRIFTS] = tilted[:, d, d]
        seconds = np.array([ends - past[i].window.begin_s for i in firsts])
        known[:, DRIFTS:, DRIFTS:] = twice[:, d, d] + np.linalg.inv(self._walk) / seconds[:, None, None]
        own = np.einsum("wij,wj->wi", gram[:, :, d], around) + pulls  # around no drift at all
        pull = inside @ own - np.einsum("lij,lj->li", level[:, :, d], at)
        tilt = (inside * along) @ own - np.einsum("lij,lj->li", tilted[:, :, d], at)
        nuisance = np.concatenate((pull[:, d], tilt[:, d]), axis=1)
        cross = np.concatenate((level[:, d, c], tilted[:, d, c]), axis=1)
        solved = np.linalg.solve(known, np.concatenate((cross, nuisance[:, :, None]), axis=2))
        information = level[:, c, c] - cross.transpose(0, 2, 1) @ solved[:, :, :-1]
        drift = solved[:, :, -1]
        score = pull[:, c] - np.einsum("lij,li->lj", cross, drift)
        # Each window's part of the score: the strongest is left out of what is believed.
        path = at[:, None, :] + drift[:, None, :DRIFTS] + along[:, :, None] * drift[:, None, DRIFTS:]
        parts = own[None, :, c] - np.einsum("wij,lwj->lwi", gram[:, c, d], path)
        parts *= inside[:, :, None]
        # What the model lacked before is known no better than it was learned, and is seen again in each window.
        again = np.einsum("lij,jk,lkm->lim", information, self.normal.unsure, information)
        squares = np.zeros((len(lengths), len(self.candidates)))
        for i, s in enumerate(self._slices):
            block = information[:, s, s]
            seen = np.min(np.diagonal(block, axis1=1, axis2=2), axis=1) > 1e-9
            size = block.shape[1]
            ridge = np.where(seen, 1e-9 * np.trace(block, axis1=1, axis2=2), 1.0)[:, None, None] * np.eye(size)
            estimate = np.linalg.solve(block + ridge, score[:, s, None])[:, :, 0]
            by_window = np.einsum("lwi,li->lw", parts[:, :, s], estimate)
            wider = 1.0 + np.trace(np.linalg.solve(block + ridge, again[:, s, s]), axis1=1, axis2=2) / size
            left = np.maximum(by_window.sum(axis=1) - by_window.max(axis=1), 0.0)
            squares[:, i] = np.where(seen, left / wider, 0.0)
        freedom = np.array([float(p.window.freedom) for p in past])
        power = np.array([p.power for p in past])
        surplus = inside @ (weights * power - freedom)
        above = np.clip((power / self.normal.power / freedom - 1.0) * np.sqrt(0.5 * freedom), *CLIPPED)
        return Looks(squares, score, information, surplus, np.sum(nuisance * drift, axis=1),
                     inside @ above / np.sqrt(np.array(lengths)))  # fmt: skip

    def surprises(self, looks: Looks) -> np.ndarray:
        """-ln of each statistic's chance in normal running (candidates + 1, lengths); 0 where there is none."""
        found = np.zeros((len(self.candidates) + 1, len(self.settings.lengths)))
        many = len(looks.power)
        spread = self.normal.spread[:, :many]
        scaled = looks.squares.T / spread[:-1]
        one = -np.log(2.0) - log_ndtr(-np.sqrt(scaled))
        found[:-1, :many] = np.where(self.freedoms[:, None] == 1, one, 0.5 * scaled)
        found[-1, :many] = -log_ndtr(-looks.power / spread[-1])
        return found

    def _event(self, kind: str, window: Window, surprises: np.ndarray) -> Event:
        surprise = float(surprises.max())
        lengths, looks = self._lengths(kind)
        # That there is a change is settled: a cause with a beginning is weighed by how much likelier it makes the
        # windows than a motor that drifts on.
        told = [self._weighed(looks, i) for i in range(len(lengths))]
        i, best = max(
            ((i, k) for i in range(len(lengths)) for k in range(len(self.candidates))),
            key=lambda at: told[at[0]][0][at[1]] + 0.5 * float(looks.taken[at[0]]),
        )
        taken = float(looks.taken[i]) + 2.0 * float(told[i][0][best])
        causes = self._causes(*told[i]) if taken >= self.settings.explained_share * float(looks.surplus[i]) else ()
        likely = np.array([w[best] for w, _ in told]) + 0.5 * looks.taken
        near = [n for n, v in zip(lengths, likely, strict=True) if v >= likely[i] - 0.5 * 3.84]
        begins = [p.window.begin_s for p in self._past]
        tries = 24.0 * 3600.0 * (len(self.candidates) + 1)
        return Event(
            kind,
            window.end_s,
            begins[-lengths[i]],
            (begins[-max(near)], begins[-min(near)]),
            surprise,
            float(tries * np.exp(-surprise)),
            causes,
        )

    def _lengths(self, kind: str) -> tuple[list[int], Looks]:
        """How many windows ago the change may have been: any number, once named near where the alarm had it."""
        low, high = min(self.settings.lengths), len(self._past)
        if kind == "named" and self._alarmed is not None:
            since = sum(p.window.begin_s >= self._alarmed.since_s for p in self._past)
            low, high = max(low, since - NEAR_WINDOWS), min(high, since + NEAR_WINDOWS)
        lengths = list(range(low, high + 1)) or [high]
        return lengths, self.looks(lengths)

    def _weighed(self, looks: Looks, i: int) -> tuple[np.ndarray, list[tuple[float, float]]]:
        """Log likelihood (candidates) over a length that each adds by Bayes' rule, its size normal around none with its
        usual size, and sizes with the halves of their 95 % intervals.
        """
        weights, sizes = [], []
        for k, (candidate, part) in enumerate(zip(self.candidates, self._slices, strict=True)):
            spread = float(self.normal.spread[k, 0])
            own, pull = looks.information[i][part, part] / spread, looks.score[i][part] / spread
            full = own + np.eye(len(own)) / candidate.usual**2
            size = np.linalg.solve(full, pull)
            weights.append(0.5 * float(pull @ size) - 0.5 * float(np.linalg.slogdet(full * candidate.usual**2)[1]))
            amount = float(size[0]) if len(size) == 1 else float(np.hypot(*size))
            sizes.append((amount, 1.96 * float(np.sqrt(np.linalg.inv(full).diagonal().mean()))))
        return np.array(weights), sizes

    def _causes(self, weights: np.ndarray, sizes: Sequence[tuple[float, float]]) -> tuple[Named, ...]:
        """Candidates by their share of the belief, each name once."""
        shares = np.exp(weights - weights.max())
        shares /= shares.sum()
        found: dict[str, Named] = {}
        for k in np.argsort(-shares):
            c, (size, half) = self.candidates[k], sizes[k]
            if c.name in found:
                found[c.name] = replace(found[c.name], share=found[c.name].share + float(shares[k]))
            elif shares[k] >= self.settings.named_share:
                found[c.name] = Named(
                    c.effect, c.what, float(shares[k]), size, (size - half, size + half), c.columns[0].unit
                )
        return tuple(sorted(found.values(), key=lambda n: -n.share))

    def _while_alarmed(self, window: Window, surprises: np.ndarray) -> list[Event]:
        self._since_alarm += 1
        recent = surprises[:, : self._recent()]
        self._quiet = self._quiet + 1 if float(recent.max()) < self.settings.over_share * self.threshold else 0
        if self._quiet >= self.settings.over_windows:
            assert self._alarmed is not None
            event = Event("over", window.end_s, self._alarmed.since_s, self._alarmed.since_ci95_s,
                          float(recent.max()), 0.0, self._alarmed.causes)  # fmt: skip
            self._alarmed = None
            self._past.clear()
            return [event]
        if self._since_alarm == self.settings.refine_windows:
            return [self._event("named", window, surprises)]
        return []

    def _recent(self) -> int:
        """How many of the lengths look back no further than an alarm takes to be over."""
        return max(1, sum(n <= self.settings.over_windows for n in self.settings.lengths))

    def _slow(self, window: Window) -> list[Event]:
        found = []
        for i, (now, most) in enumerate(zip(self.at, self.settings.drifted, strict=True)):
            sd = float(np.sqrt(self.covariance[i, i]))
            far = abs(now) - 3.0 * sd > most
            if far and not self._drifted[i]:
                effect, what, unit = DRIFT_NAMES[i]
                cause = Named(effect, what, 1.0, float(now), (float(now - 1.96 * sd), float(now + 1.96 * sd)), unit)
                found.append(Event("drifted", window.end_s, 0.0, (0.0, window.end_s), 0.0, 0.0, (cause,)))
            self._drifted[i] = far or (self._drifted[i] and abs(now) > 0.8 * most)
        return found
