"""What a search carries on: structures, the candidates beside them, and what was added in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fiohost.discover.candidate import Candidate
from fiohost.discover.evidence import State
from fiohost.discover.settings import SETTINGS
from fiohost.motor.effect import Effect

if TYPE_CHECKING:
    from fiohost.discover.search import Search


@dataclass(frozen=True)
class Child:
    """A candidate carried to its minimum beside a node, and by how much its deviance is below that node's."""

    effect: Effect
    state: State
    gain: float

    @property
    def name(self) -> str:
        return self.effect.name

    @property
    def share(self) -> float:
        """Of the residual's power, as deviance counts it."""
        return 1.0 - float(np.exp(-max(self.gain, 0.0) / max(self.state.fit.samples, 1.0)))

    @property
    def price(self) -> float:
        """That of its state, and on how rare the effect is."""
        return self.state.price + SETTINGS.rare * self.effect.commonness

    @property
    def simplicity(self) -> tuple[int, int, float]:
        """How many parameters, how rare, and the price."""
        return len(self.effect.parameters), self.effect.commonness, self.price


@dataclass(eq=False)
class Node:
    """A structure on the way: its state, what was added in turn to come there, whether chance does not reach what the
    library gains beside it, though no name is believed, and whether no candidate comes near the data (``far``).
    """

    state: State
    added: tuple[Added, ...] = ()
    lacks: bool = False
    far: bool = False

    @property
    def names(self) -> frozenset[str]:
        return frozenset(a.child.name for a in self.added)

    @property
    def rarity(self) -> int:
        return sum(a.child.effect.commonness for a in self.added)

    @property
    def price(self) -> float:
        """That of its state, and on how rare what was added is."""
        return self.state.price + SETTINGS.rare * self.rarity

    @property
    def simplicity(self) -> tuple[int, int, float]:
        """How many parameters, how rare what was added is, and the price."""
        return len(self.state.fit.names), self.rarity, self.price


@dataclass(eq=False)
class Added:
    """An effect that a search added to the node ``before``, with the ``accepted`` candidates beside it, the ``level``
    that chance reached with it, and the node ``after`` it.
    """

    by: Search[Any]
    child: Child
    before: Node
    accepted: Sequence[Child]
    level: float
    after: Node | None = None


@dataclass(frozen=True)
class Expanded:
    """What a search found beside a node: the nodes with one effect more, and how all candidates did."""

    node: Node
    children: tuple[Node, ...]
    told: list[Candidate]
