"""Logs as evidence in one-second windows, all weighed alike: they lead where whole runs do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

from fiohost.discover.evidence import State, deviance_of
from fiohost.discover.logs.evidence import Logs
from fiohost.discover.logs.screen import Screen
from fiohost.discover.logs.whitened import plain
from fiohost.discover.settings import SETTINGS
from fiohost.estimation.fit import Fit
from fiohost.estimation.record import Record, thinned


class PlainWindows(Logs):
    """One-second windows weighed alike, their angles and speeds free.

    Where two effects are missing no one of them brings whole runs near the data, and gradients lead nowhere. Windows
    are nearly convex and say which leaves less. Nothing that they say is believed before whole runs follow it, so that
    no noise need be known: counts are all that a true model leaves.
    """

    exact = False

    def cut(self, records: list[Record]) -> list[Record]:
        every = -(-sum(len(r.windows) - 1 for r in records) // self.settings.most_windows)
        return [replace(thinned(r, SETTINGS.window_step_s), every=every) for r in records]

    @cached_property
    def plain(self) -> list[Record]:
        """They as they are, whatever noise was found."""
        return plain(self.records)

    @property
    def margin(self) -> float:
        return self.settings.margin_in_windows

    @property
    def least_taken(self) -> float:
        """The least share of what windows leave that leads on: noise might do for less."""
        return self.settings.least_of_rest

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        return State(fitted, deviance_of(fitted), tuple(self.plain))

    def screens(self, state: State) -> list[Screen]:
        return [Screen(state.fit, self.plain)]

    def floor_rms(self, state: State) -> float:
        return float("inf")

    def reached(self, fitted: Fit, floor_rms: float) -> bool:
        return fitted.rms <= self.most_of_counts

    def as_they_are(self, state: State) -> Fit:
        """A state's model fitted to windows as they are."""
        return state.fit

    def taken(self, before: State, after: State) -> float:
        """The share of the squared error of windows as they are that one state takes of another's."""
        return 1.0 - self.as_they_are(after).cost / max(self.as_they_are(before).cost, 1e-300)

    def immaterial(self, before: State, after: State) -> str | None:
        taken = self.taken(before, after)
        # Where counts are all that is left, there is no noise that might do for less.
        if taken >= self.least_taken or self.reached(before.fit, 0.0):
            return None
        return f"removes {100 * max(taken, 0.0):.0f} % of what windows leave"

    def plainly(self, before: State, after: State, names: Sequence[str]) -> bool:
        # Whatever takes enough may lead on: beside what is missing left-out blocks scatter, and whole runs decide.
        return self.immaterial(before, after) is None and self.degenerate(after, names) is None

    def _nothing_left(self, before: State, after: State, group: Sequence[int]) -> bool:
        return self.white(after)
