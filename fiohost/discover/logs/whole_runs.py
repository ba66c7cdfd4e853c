"""Logs as evidence in free runs of whole records, where a motor repeats itself to the count."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.discover.evidence import State, deviance_of
from fiohost.discover.logs.evidence import Logs
from fiohost.discover.logs.local_minima import polish, unstuck
from fiohost.discover.logs.non_smooth import searched_again
from fiohost.discover.logs.screen import Screen
from fiohost.discover.score import objection
from fiohost.estimation.fit import Fit


class WholeRuns(Logs):
    """Free runs of whole records: counts are all that a true model leaves."""

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        return State(fitted, deviance_of(fitted), tuple(self.records))

    def screens(self, state: State) -> list[Screen]:
        return [Screen(state.fit, self.records)]

    def as_good(self, state: State, best: State) -> bool:
        # Counts of whole runs err alike and do not average out; of a shaft that mostly rests few are read at all.
        at_rest = self.few and self.mostly_rests and self.only_counts(state)
        return at_rest or state.fit.cost <= self.settings.as_good * best.fit.cost

    def only_counts(self, state: State) -> bool:
        """Whether nothing but the rounding to counts is left: no other structure could leave less."""
        return state.fit.rms <= self.most_of_counts

    @property
    def mostly_rests(self) -> bool:
        """Whether the shaft stands still for most of the time: its readings then are few, each of them many times."""
        moving = sum(float(r.weights @ r.weights) for r in self.records)
        return moving < self.settings.mostly * sum(len(r) for r in self.records)

    def near_counts(self, state: State) -> bool:
        """Whether a fit may be on a ledge beside one that leaves nothing but the rounding to counts."""
        return state.fit.rms**2 <= self.settings.near_counts * self.most_of_counts**2

    def finished(self, state: State) -> State:
        if state not in self._finished:
            found = self._off_ledges(self._off.get(state) or super().finished(state), self.rng)
            self._finished[state] = self._finished[found] = found
        return self._finished[state]

    def _off_ledges(self, state: State, rng: np.random.Generator) -> State:
        """A state with its non-smooth parameters searched again, and got out of a local minimum."""
        found, records = state.fit, self.records
        if any(found.model.parameter(n).ragged for n in found.names) and not self.stage(state).at_floor:
            better = searched_again(found, records)
            if better.cost < found.cost and not _doubted(better):
                state = self.settled(better)
        stage, found = self.stage(state), state.fit
        if stage.windows_above_floor > self.settings.stuck:
            return state
        # Three experiments or more leave a fit few ledges far from its minimum; but one that follows them is the last.
        if self.only_counts(state) or not (self.few or stage.follows):
            return self.polished(state, rng)
        better = unstuck(found, records, rng)
        return state if better.cost >= found.cost or _doubted(better) else self.settled(better)

    def _nothing_to_gain(self, state: State) -> bool:
        """Whether counts are all that is left, and replicas err as much: where stick decides by last digits, these may
        err by far more than counts, and so may a fit on a ledge.
        """
        return self.only_counts(state) and self.stage(state).at_floor

    def polished(self, state: State, rng: np.random.Generator | None = None) -> State:
        if self._nothing_to_gain(state):
            return state
        if state not in self._polished:
            better = polish(state.fit, state.records, rng or self.rng)
            found = state if better is state.fit or _doubted(better) else self.settled(better)
            self._polished[state] = self._polished[found] = found
        return self._polished[state]

    def _nothing_left(self, before: State, after: State, group: Sequence[int]) -> bool:
        stage, enough = self.stage(before), self.settings.finished
        if stage.left_of(after.fit, group) <= enough:
            return True
        # One that comes to the floor of all may stand on a ledge in those that show it.
        if not self.reached(after.fit, stage.floor_rms):
            return False
        # Many are asked at once: each has draws of its own, whoever comes first.
        self._off[after] = self._off_ledges(after, np.random.default_rng(self._judging))
        return stage.left_of(self._off[after].fit, group) <= enough


def _doubted(found: Fit) -> bool:
    """Whether something speaks against the effect that was added last."""
    return any(objection(found, name) for name in found.model.effects[-1:])
