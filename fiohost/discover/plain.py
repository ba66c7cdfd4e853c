"""Windows as they are, of a motor that repeats itself to the count: what leads whole runs to where they follow.

Where two effects are missing no one of them brings whole runs near the data, and gradients lead nowhere. One-second
windows are nearly convex and say which of them leaves less. Nothing that is found here is believed before whole runs
follow it, so that no noise need be known: counts are all that a true model leaves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.discover.evidence import State, deviance_of
from fiohost.discover.objective import Windows
from fiohost.discover.screen import Screen
from fiohost.estimation.fit import Fit
from fiohost.estimation.record import Record


class PlainWindows(Windows):
    """One-second windows weighed alike, their angles and speeds free."""

    def __init__(self, train: Sequence[Record], rng: np.random.Generator | None = None) -> None:
        super().__init__(train, rng)
        self.anew = False  # whole runs are begun anew themselves

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        return State(fitted, deviance_of(fitted), tuple(self.plain))

    def screens(self, state: State) -> list[Screen]:
        return [Screen(state.fit, self.plain)]

    def under(self, state: State, other: State) -> Fit:
        return state.fit

    def chance(self, state: State, best: State) -> State:
        return state

    def as_they_are(self, state: State) -> Fit:
        return state.fit

    def plainly(self, before: State, after: State, names: Sequence[str]) -> bool:
        # Whatever takes enough may lead on: beside what is missing left-out blocks scatter, and whole runs decide.
        return self.immaterial(before, after) is None and self.degenerate(after, names) is None

    def no_noise(self, state: State) -> bool:
        return False

    def white(self, state: State) -> bool:
        return self.stage(state).follows
