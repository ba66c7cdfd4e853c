"""Which candidates are believed, and which of several comes first: what a search asks of evidence about each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

import numpy as np

from fiohost.discover.evidence import Evidence, J
from fiohost.discover.nodes import Child, Node
from fiohost.discover.null import Null
from fiohost.motor.effect import Effect
from fiohost.motor.model import Model

Ranked = TypeVar("Ranked", Node, Child)


class Belief(Generic[J]):
    """What one evidence says of candidates beside nodes."""

    def __init__(self, evidence: Evidence[J]) -> None:
        self.evidence, self.settings = evidence, evidence.settings

    def stage(self, node: Node) -> J:
        """A node judged on all data."""
        return self.evidence.stage(node.state)

    def best_first(self, items: Sequence[Ranked]) -> list[Ranked]:
        """Nodes or children by price, before them those that are as good as the best one: the simplest, then the
        commonest.
        """
        order: list[Ranked] = sorted(items, key=lambda i: i.price)
        least = min(order, key=lambda i: i.state.deviance, default=None)
        if least is None:
            return order
        equal: list[Ranked] = [i for i in order if self.evidence.as_good(i.state, least.state)]
        others: list[Ranked] = [i for i in order if i not in equal]
        return sorted(equal, key=lambda i: i.simplicity) + others

    def surely(self, node: Node, child: Child) -> bool:
        """Whether left-out data gain by a candidate what is worth a name, be it this one or another."""
        e = self.evidence
        return e.immaterial(node.state, child.state) is None and e.gain(node.state, child.state).sure(self.settings)

    def close(self, child: Child, null: Null) -> bool:
        """Whether a null of few samples may be wrong about a candidate."""
        asked, factor = self.asked(child, null), self.settings.plainly_told
        return asked / factor < child.gain < factor * asked

    def margin(self, of: Effect) -> float:
        """How many times what chance reaches an effect has to gain; what every drive has is no surprise."""
        return self.settings.margin if of.everywhere else self.evidence.margin

    def asked(self, child: Child, null: Null) -> float:
        """The deviance that a candidate has to gain."""
        return self.margin(child.effect) * null.of(child.name)

    def objection(self, node: Node, child: Child, null: Null) -> str | None:
        """Why a candidate is not believed, or None."""
        s, e, of, after = self.settings, self.evidence, child.effect, child.state
        if after is node.state:
            return "is within what differs from run to run"
        left = after.fit.rms / self.stage(node).floor_rms if e.exact else np.inf
        finished = left <= s.finished
        if e.exact and of.once and left > s.lost:
            return f"an event that happened once and leaves {left:.2f} times the floor cannot be confirmed"
        if child.gain < self.asked(child, null) and not finished:
            return f"gains {max(child.gain, 0.0):.0f} of deviance, chance alone {null.of(child.name):.0f}"
        if node.added and (why := e.immaterial(node.state, after)):
            return why
        # An earlier name that vanishes beside this one was mistaken for a part of it, and goes.
        names = [child.name, *(n for n in node.names if not e.vanishes(after, n))]
        if not of.once and e.plainly(node.state, after, names):  # no other record can confirm an event
            return None
        if why := e.degenerate(after, names):
            return why
        if e.exact and node.added:
            above = 1.0 - (left**2 - 1.0) / max((node.state.fit.rms / self.stage(node).floor_rms) ** 2 - 1.0, 1e-12)
            if above < s.least_of_rest:
                return f"removes {100 * max(above, 0.0):.0f} % of what still stands above the floor"
        if not (of.shown or of.once) and (why := e.unconfirmed(node.state, after, child.name)):
            return why
        if e.exact and of.once:
            return None  # no other record can confirm it: it leads on, and is believed where whole runs are followed
        gain = e.gain(node.state, after)
        if not gain.sure(s):
            return f"gains {gain.total:.0f} of deviance on left-out training data, give or take {gain.error:.0f}"
        if not of.shown and gain.by_one:
            return "is carried by one stretch of 2 s"
        return None

    def in_order(self, accepted: Sequence[Child]) -> list[Child]:
        """Candidates, the best first; those of an exact fit that are near it are carried to their minimum before."""
        if self.evidence.exact:
            least = min((c.state.fit.cost for c in accepted), default=0.0)
            near = [c for c in accepted if c.state.fit.cost <= 1.1 * least]
            if len(near) > 1:  # the last digits decide between them
                accepted = [self._polished(c) if c in near else c for c in accepted]
        return self.best_first(accepted)

    def _polished(self, child: Child) -> Child:
        state = self.evidence.polished(child.state)
        return Child(child.effect, state, child.gain + child.state.deviance - state.deviance)

    def rivals(self, child: Child, accepted: Sequence[Child]) -> dict[str, Model]:
        """Those that left-out data cannot tell from a candidate, however noise is weighed."""
        e, found = self.evidence, dict[str, Model]()
        for other in (c for c in accepted if c.name != child.name):
            told_apart = e.gain(other.state, child.state).tells_apart(self.settings) or e.plainly(
                other.state, child.state, [child.name]
            )
            shares = other.gain >= self.settings.shared_gain * child.gain
            if e.as_good(other.state, child.state) or (shares and not told_apart):
                found[other.name] = other.state.fit.model
        return found
