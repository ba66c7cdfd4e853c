"""The objective: simulation error by multiple shooting, the horizon as long as the noise lets it be.

A motor that repeats itself to the count is fitted in whole runs: there the counts are all that a true model leaves. One
that does not is fitted in one-second windows, each with its own angle and speed, weighed by the covariance of the noise
that is left (``weighed_windows``). Each gives a deviance, -2 log likelihood but for a constant; all else works on that.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from fiohost.discover.candidate import Progress
from fiohost.discover.degenerate import core_lost
from fiohost.discover.evidence import Evidence, State
from fiohost.discover.logs.folds import beginning, folds
from fiohost.discover.logs.left_out import left_out, only_in
from fiohost.discover.logs.moments import fit_event, unconfirmed_moment
from fiohost.discover.logs.non_smooth import chosen_again
from fiohost.discover.logs.optimise import again, carried_on
from fiohost.discover.logs.refit import LogsBeside
from fiohost.discover.logs.screen import Screen
from fiohost.discover.logs.whitened import drawing, plain
from fiohost.discover.score import Gain, objection, vanishes
from fiohost.discover.settings import SETTINGS, SearchSettings
from fiohost.estimation.fit import Fit, fit_from_scratch
from fiohost.estimation.record import Record
from fiohost.judging.followed import dependences
from fiohost.judging.stage import Stage, judged
from fiohost.motor.effect import Effect, effect
from fiohost.motor.model import Model


class Logs(Evidence[Stage]):
    """Training records, or pieces of them where they are few, as they are fitted."""

    def __init__(
        self,
        train: Sequence[Record],
        rng: np.random.Generator | None = None,
        anew: bool = False,
        settings: SearchSettings = SETTINGS,
    ) -> None:
        """``anew`` says that candidates may begin from values of their own where none comes close."""
        super().__init__(rng, settings)
        self.train, self.anew = train, anew
        pieces, self.groups = folds(train)
        self.records = self.cut(pieces)
        # Every structure is judged by the same draws: no luck between two, nor by the way that a search took.
        self._judging = int(self.rng.integers(2**32))
        self._own: WeakKeyDictionary[State, np.ndarray] = WeakKeyDictionary()
        # What was got off its ledge when it was asked whether it is confirmed.
        self._off: WeakKeyDictionary[State, State] = WeakKeyDictionary()
        self._finished: WeakKeyDictionary[State, State] = WeakKeyDictionary()
        self._polished: WeakKeyDictionary[State, State] = WeakKeyDictionary()

    def cut(self, records: list[Record]) -> list[Record]:
        """The records as they are fitted."""
        return records

    @property
    def few(self) -> bool:
        """Whether there are fewer than three experiments."""
        return len(self.records) > len(self.train)

    @cached_property
    def beginnings(self) -> list[Record]:
        """The beginnings of all whole runs, in all as long as what is searched of windows: what no effect follows there
        none does to the end.
        """
        share_s = self.settings.most_windows / len(self.records)
        return [beginning(r, share_s) for r in self.records]

    @property
    def long(self) -> bool:
        """Whether they are but a part of the runs: windows of so much show what whole runs do."""
        return any(r is not b for r, b in zip(self.records, self.beginnings, strict=True))

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        """The state of a fit, its deviance comparable with those of others; ``whitened`` says that it was fitted so."""
        raise NotImplementedError

    def screens(self, state: State) -> list[Screen]:
        """Around which fits the library is scored."""
        raise NotImplementedError

    def no_noise(self, state: State) -> bool:
        """Whether the random torque that a state leaves is larger than any bench's."""
        return False

    def under(self, state: State, other: State) -> Fit:
        """A state's model fitted under another's noise."""
        return state.fit

    def chance(self, state: State, best: State) -> State:
        """A state with the noise that the best candidate leaves: were nothing missing, it would be the state's own."""
        return state

    def floor_rms(self, state: State) -> float:
        """The error that whole runs of a state could reach."""
        return self.stage(state).floor_rms

    @property
    def most_of_counts(self) -> float:
        """The highest error of a fit that leaves nothing but the rounding to counts."""
        return self.settings.finished * max(r.quantum for r in self.records) / float(np.sqrt(12.0))

    def reached(self, fitted: Fit, floor_rms: float) -> bool:
        """Whether a fit comes to a floor, below which no other structure leads."""
        return fitted.rms <= self.settings.finished * floor_rms

    def judge(self, state: State) -> Stage:
        train = drawing(self.train, state.noise) if state.noise else self.train
        return judged(state.fit, state.records, train, np.random.default_rng(self._judging))

    def declared(self, model: Model, from_file: bool) -> State:
        return self.settled(fit_from_scratch(model, self.records, keep_start=from_file, windows=not self.exact))

    def beside(self, state: State) -> LogsBeside:
        return LogsBeside(self, state)

    def in_place_of(
        self, state: State, name: str, library: Sequence[str] | None, say: Progress
    ) -> list[tuple[Effect, State]]:
        return LogsBeside(self, state).in_place_of(name, library, say)

    def finished(self, state: State) -> State:
        """A state with the choices and moments of effects that were named before its last one looked for again: what
        was missing then may have led elsewhere, and no gradient leads back.
        """
        records, earlier = state.records, state.fit.model.effects[:-1]

        def better(state: State, found: Fit) -> State:
            paid = found.cost < state.fit.cost * (1.0 - self.settings.optimiser.paid)
            return self.settled(carried_on(found, records), whitened=True) if paid else state

        for event in (e for e in map(effect, earlier) if e.once):
            found = fit_event(self.without(state, event.name).fit, event, plain(records))
            state = better(state, again(state.fit, state.fit.model.with_values(found.model.values), records))
        return better(state, chosen_again(state.fit, records, [n for n in earlier if not effect(n).once]))

    def without(self, state: State, name: str) -> State:
        return self.settled(again(state.fit, state.fit.model.without([name]), state.records))

    def gain(self, before: State, after: State) -> Gain:
        if after not in self._own:
            self._own[after] = self._left_out(after.fit, after)
        return Gain.of(self._left_out(self.under(before, after), after), self._own[after], self.settings)

    def _left_out(self, fitted: Fit, under: State) -> np.ndarray:
        """Deviance of left-out blocks of a fit, under the noise that a state leaves."""
        return left_out(fitted, under.variance, under.records, self.groups)

    def degenerate(self, state: State, names: Sequence[str]) -> str | None:
        whys = (objection(state.fit, n) or unconfirmed_moment(state.fit, effect(n), state.records) for n in names)
        if why := next((w for w in whys if w), None):
            return why
        lost = core_lost(state.bare or state.fit)
        # Of noise that is none weights promise too much; of noise that is one, windows as they are know too little.
        return lost if lost is None or state.bare is None or not self.white(state) else core_lost(state.fit)

    def vanishes(self, state: State, name: str) -> bool:
        return vanishes(state.fit, name)

    def unconfirmed(self, before: State, after: State, name: str) -> str | None:
        group = only_in(after.fit, name, self.groups)
        if group is None or self._nothing_left(before, after, group):
            return None
        return f"only {self.records[group[0]].name} shows it, and something is left"

    def _nothing_left(self, before: State, after: State, group: Sequence[int]) -> bool:
        """Whether a state explains the only records that show what it has more than the one before."""
        raise NotImplementedError

    def follows(self, state: State) -> dict[str, object]:
        found = dependences(self.train, state.fit.model, self.stage(state).judgements, self.rng)
        return {d.variable: d.to_json() for d in found if d.significant}
