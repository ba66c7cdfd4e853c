"""What a search asks of evidence, be it logs in whole runs, logs in windows or tables of readings.

A structure is fitted to evidence, which says by how much deviance it is better than another, what chance reaches, and
what data that a fit had not seen say of it. All the rest is the same for all evidence: ``search``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from fiohost.discover.candidate import Candidate, Progress
from fiohost.discover.null import Decided, Null
from fiohost.discover.score import Gain
from fiohost.discover.settings import SETTINGS, SearchSettings
from fiohost.estimation.fit import Fit
from fiohost.estimation.record import Record
from fiohost.motor.effect import Effect
from fiohost.motor.model import Model
from fiohost.noise.covariance import Movement
from fiohost.noise.estimate import Noise


@dataclass(frozen=True, eq=False)
class State:
    """A fitted structure and its ``deviance``, -2 log likelihood but for a constant, comparable between structures.

    Of logs also the ``records`` as they were fitted; of windows the ``noise`` that it leaves, how the shaft moves there
    (``moving``), and ``bare``, its fit to windows as they are.
    """

    fit: Fit
    deviance: float
    records: tuple[Record, ...] = ()
    noise: Noise | None = None
    moving: tuple[Movement, ...] = ()
    bare: Fit | None = None

    @property
    def price(self) -> float:
        """Deviance with a price on each parameter (Schwarz 1978)."""
        return self.deviance + len(self.fit.names) * float(np.log(max(self.fit.samples, 2.0)))

    @property
    def variance(self) -> float:
        """Of what is left, in the unit in which residuals are squared: 1 where whitened, unless more is left."""
        of_fit = self.fit.cost / max(self.fit.samples, 1.0)
        return max(of_fit, 1.0) if self.noise else of_fit


def deviance_of(fitted: Fit) -> float:
    """-2 log likelihood of a fit whose errors are alike and of a size that it leaves itself, but for a constant."""
    n = max(fitted.samples, 1.0)
    return n * float(np.log(max(fitted.cost / n, 1e-300)))


def whitened_deviance(fitted: Fit) -> float:
    """The same of a fit whitened by the noise of steady motion, but for the weights. Where more is left than that
    noise, it is taken for as much larger (its scale concentrated out).
    """
    cost, n = fitted.cost, max(fitted.samples, 1.0)
    return cost if cost <= n else n * (1.0 + float(np.log(cost / n)))


class Judged(Protocol):
    """A fitted model beside the floor that its data could reach: its error there, whether it follows the data as
    closely as they can tell, and the error as a share of what there is to explain.
    """

    @property
    def fit(self) -> Fit: ...

    @property
    def floor_rms(self) -> float: ...

    @property
    def follows(self) -> bool: ...

    @property
    def left_pct(self) -> float: ...


J = TypeVar("J", bound=Judged)


class Beside(Protocol):
    """What the library does beside one state."""

    def offered(self, library: Sequence[str] | None) -> tuple[list[Effect], list[Candidate]]:
        """The effects that may be added, and those of which this evidence says nothing."""

    def refitted(
        self, offered: Sequence[Effect], say: Progress, *, rival: State | None = None
    ) -> list[tuple[Effect, State]]:
        """The best of them, each at its minimum; those that come nowhere near from here begin from values of their own,
        unless there is a ``rival`` that they have to do as well as.
        """

    def passed_over(self) -> list[Candidate]:
        """How those did that were not refitted to the end."""

    def null(self, best: State, decided: Decided = lambda null: False) -> Null:
        """What chance reaches, with the noise that the best candidate leaves: were nothing missing, it would be the
        state's own. No more is drawn for it once it has ``decided``.
        """


class Evidence(ABC, Generic[J]):
    """What was measured, as a search sees it. Draws are from ``rng``."""

    # Whether the floor is known, from counts or digits: then a fit that reaches it explains the data.
    exact = True

    def __init__(self, rng: np.random.Generator | None = None, settings: SearchSettings = SETTINGS) -> None:
        self.rng, self.settings = rng or np.random.default_rng(0), settings
        self._stages: WeakKeyDictionary[State, J] = WeakKeyDictionary()

    def stage(self, state: State) -> J:
        """A state judged on all data, once."""
        if state not in self._stages:
            self._stages[state] = self.judge(state)
        return self._stages[state]

    @property
    def margin(self) -> float:
        """How many times what chance reaches a candidate has to gain."""
        return self.settings.margin

    @abstractmethod
    def judge(self, state: State) -> J:
        """A state judged on all data."""

    @abstractmethod
    def declared(self, model: Model, from_file: bool) -> State:
        """The declared model fitted from scratch, and from its own values where they are ``from_file``."""

    @abstractmethod
    def beside(self, state: State) -> Beside:
        """What the library does beside a state."""

    @abstractmethod
    def without(self, state: State, name: str) -> State:
        """A state fitted again without one of its effects."""

    @abstractmethod
    def gain(self, before: State, after: State) -> Gain:
        """How much less deviance one state leaves than another in data left out of their fits."""

    def held_against(self, state: State, found: Sequence[tuple[Effect, State]]) -> State:
        """What candidates ``found`` beside a state have to leave less than: it, with what chance may do in it."""
        return state

    def in_place_of(
        self, state: State, name: str, library: Sequence[str] | None, say: Progress
    ) -> list[tuple[Effect, State]]:
        """Other effects in the place of one of a state's, begun from where that led the others."""
        return []

    def as_good(self, state: State, best: State) -> bool:
        """Whether the data tell a state from the best one no more than chance does."""
        return False

    def finished(self, state: State) -> State:
        """A state got out of a local minimum."""
        return state

    def polished(self, state: State) -> State:
        """A state carried to the bottom of its minimum."""
        return state

    def degenerate(self, state: State, names: Sequence[str]) -> str | None:
        """Why a fit cannot be believed by its own parameters, or None; ``names`` are the effects to be asked about."""
        return None

    def vanishes(self, state: State, name: str) -> bool:
        """Whether one of a state's effects may as well not be there, by its fitted parameters."""
        return False

    def unconfirmed(self, before: State, after: State, name: str) -> str | None:
        """Why no other data confirm an effect, or None."""
        return None

    def immaterial(self, before: State, after: State) -> str | None:
        """Why a further effect takes too little to be worth a name, or None."""
        return None

    def plainly(self, before: State, after: State, names: Sequence[str]) -> bool:
        """Whether the data speak for the effects ``names`` however noise is weighed."""
        return False

    def white(self, state: State) -> bool:
        """Whether what a state leaves is noise: white, and followed by nothing."""
        return self.stage(state).follows

    def follows(self, state: State) -> dict[str, object]:
        """What the residual of a state depends on, by variable."""
        return {}
