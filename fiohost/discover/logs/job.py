"""What is refitted, and what it asks of the logs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from fiohost.discover.evidence import State
from fiohost.discover.logs.scores import Score
from fiohost.discover.logs.screen import Screen
from fiohost.discover.settings import SearchSettings
from fiohost.estimation.fit import Fit
from fiohost.estimation.record import Record


class Logs(Protocol):
    """What is asked of the logs' evidence."""

    exact: bool
    # Whether candidates may begin from values of their own where none comes close.
    anew: bool
    settings: SearchSettings
    rng: np.random.Generator
    records: list[Record]

    @property
    def beginnings(self) -> list[Record]:
        """The beginnings of all whole runs: what no effect follows there none does to the end."""

    @property
    def long(self) -> bool:
        """Whether they are but a part of the runs."""

    @property
    def few(self) -> bool:
        """Whether there are fewer than three experiments."""

    def screens(self, state: State) -> list[Screen]:
        """Around which fits the library is scored."""

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        """The state of a fit."""

    def no_noise(self, state: State) -> bool:
        """Whether the random torque that a state leaves is larger than any bench's."""

    def white(self, state: State) -> bool:
        """Whether what a state leaves is noise."""

    @property
    def margin(self) -> float:
        """How many times what chance reaches a candidate has to gain."""

    def degenerate(self, state: State, names: Sequence[str]) -> str | None:
        """Why a fit cannot be believed by its own parameters, or None."""

    def chance(self, state: State, best: State) -> State:
        """A state with the noise that the best candidate leaves."""

    def floor_rms(self, state: State) -> float:
        """The error that whole runs of a state could reach; infinite where none is known."""

    def reached(self, fitted: Fit, floor_rms: float) -> bool:
        """Whether a fit comes to a floor, below which no other structure leads."""


class Job(NamedTuple):
    """A scored effect, and what it is refitted beside."""

    score: Score
    base: Fit
    records: Sequence[Record]

    @property
    def name(self) -> str:
        return self.score.effect.name
