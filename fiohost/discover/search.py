"""The search: a beam over structures, from a declared model to what it lacks, on training data alone.

score the library -> refit the best -> null -> left-out data -> add -> drop what is not needed -> again

Adding, dropping and exchanging are the moves; with more than one structure carried on, an effect that was mistaken for
a part of another gives way by them. What is measured, and how, only the evidence knows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Generic
from weakref import WeakKeyDictionary

import numpy as np

from fiohost.discover.belief import Belief
from fiohost.discover.candidate import Candidate, Progress
from fiohost.discover.evidence import Beside, Evidence, J, State
from fiohost.discover.nodes import Added, Child, Expanded, Node
from fiohost.discover.null import Null
from fiohost.discover.step import Found, Step, named_with
from fiohost.motor.effect import Effect
from fiohost.motor.model import Model
from fiohost.workers import each


class Search(Generic[J]):
    """One search over one evidence; ``tolerance_pct`` is the share of the motion that does not matter, ``enough`` says
    of a node whether other evidence is explained by it, ``in_vain`` whether no structure can explain this one.
    """

    def __init__(
        self,
        evidence: Evidence[J],
        library: Sequence[str] | None,
        say: Progress,
        *,
        tolerance_pct: float = 0.0,
        enough: Callable[[Node], bool] = lambda node: False,
        in_vain: Callable[[Node], bool] = lambda node: False,
    ) -> None:
        self.evidence, self.library, self.say, self.tolerance_pct = evidence, library, say, tolerance_pct
        self.belief = Belief(evidence)
        self.enough, self.in_vain = enough, in_vain
        self.settings = evidence.settings
        self.told: list[Candidate] = []
        self.known: dict[frozenset[str], Expanded] = {}
        self.replaced: WeakKeyDictionary[State, dict[str, list[tuple[Effect, State]]]] = WeakKeyDictionary()

    def declared(self, model: Model, from_file: bool) -> Node:
        """Where every search begins: the declared model fitted."""
        return Node(self.evidence.finished(self.evidence.declared(model, from_file)))

    def run(self, root: Node, most: int | None = None) -> Node:
        """The best structure that the data speak for, with so many effects at most. What is exchanged at the end for
        what led there is asked in its turn what it lacks.
        """
        most = most or self.settings.most_effects
        best, seen = self.longest(root, most), set[frozenset[str]]()
        while (other := self.exchanged(best)) is not best and other.names not in seen:
            seen.add(other.names)
            best = self.longest(other, most)
            if best is other:
                break
        return other

    def longest(self, root: Node, most: int) -> Node:
        """The best structure that effects added to one lead to."""
        beam, best = [root], root
        while len(best.added) < most and not (self.explains(best) or self.in_vain(best)):
            beam = self.belief.best_first(self.next_ones(beam))
            # Beside more names than most motors lack, the best structure alone is carried on.
            several = beam and len(beam[0].added) < self.settings.most_before_windows
            beam = beam[: self.settings.beam if several else 1]
            if not beam or (best is not root and beam[0].price >= best.price):
                break
            best = next((n for n in beam if self.explains(n)), beam[0])
            if not self.explains(best) and (other := self.in_its_place(best, best.added[-1])):
                beam = [other, *(n for n in beam if n.names != other.names)][: len(beam)]
                best = other
        return best

    def in_its_place(self, node: Node, named: Added) -> Node | None:
        """A node with another effect in the place of one that was added, which led the fit to where that other explains
        more; None where there is none.
        """
        e, was = self.evidence, named.child.name
        of_node = self.replaced.setdefault(node.state, {})
        if was not in of_node:  # the same node is met again where other effects are asked for beside the first
            of_node[was] = e.in_place_of(node.state, was, self.library, self.say)
        found = [Child(of, state, 0.0) for of, state in of_node[was]]
        better = [c for c in found if c.state.price < node.state.price]
        if not better:
            return None
        others = tuple(a for a in node.added if a is not named)
        before = named.before if named is node.added[-1] else Node(e.without(node.state, was), others)
        null = Null(named.level, {}, ())
        for child in self.belief.best_first(
            [replace(c, gain=before.state.deviance - c.state.deviance) for c in better]
        ):
            if self.belief.objection(before, child, null) is None:
                grown = self.grown(before, child, [child], named.level)
                return grown if grown.price < node.price else None
        return None

    def next_ones(self, beam: Sequence[Node], *, rival: Node | None = None) -> list[Node]:
        """The nodes with one more effect than those of a beam; the one that explains the data, where one does, one with
        a named effect before one with a general curve, which holds what others say. Where there is a ``rival`` they
        have to do as well as it does.
        """
        grown: dict[frozenset[str], Node] = {}
        for node in beam:
            curved: list[Node] = []
            for child in self.expand(node, rival=rival) if rival else self.expanded(node):
                if self.explains(child):
                    if not child.added[-1].child.effect.points:
                        return [child]
                    curved.append(child)
                was = grown.get(child.names)
                if was is None or child.state.price < was.state.price:
                    grown[child.names] = child
            if curved:
                return curved[:1]
            if not grown and node is not beam[-1] and (self.evidence.exact or self.white(node)):
                break  # beside the best one nothing is missing
        return list(grown.values())

    def exchanged(self, best: Node, *, root: Node | None = None) -> Node:
        """A structure with each of its names but the last asked for again beside the others: it was chosen while they
        were missing, and stays only where it is believed beside them. The last too, where other evidence chose it:
        alone it is asked for from the ``root``. Beside what an exact fit does not follow nothing can be told by it, nor
        by windows what whole runs are to be asked.
        """
        if (self.evidence.exact and not self.explains(best)) or self.enough(best):
            return best
        asked: set[tuple[str, frozenset[str]]] = set()

        def not_asked() -> Added | None:
            names = best.added if root else best.added[:-1]
            return next((a for a in names if (a.child.name, best.names) not in asked), None)

        while earlier := not_asked():
            asked.add((earlier.child.name, best.names))
            best = self.asked_again(best, earlier, root)
        return best

    def asked_again(self, best: Node, earlier: Added, root: Node | None) -> Node:
        """A structure in which one of its names is asked for again beside the others."""
        name, explained = earlier.child.name, self.explains(best)
        self.say(f"{name}, asked for again beside the others")
        others = tuple(a for a in best.added if a is not earlier)
        # What is fitted without a name that was mistaken keeps to where that had led.
        rest = Node(self.evidence.without(best.state, name), others) if others or root is None else root
        doubted = None if explained else self.doubted(best, earlier, rest)
        stays, told = doubted or best, self.told
        led_to = None if explained else self.in_its_place(best, earlier)
        first = self.belief.best_first([*self.next_ones([rest], rival=best), *([led_to] if led_to else []), stays])[0]
        self.told = told
        if first is not stays:
            last = first.added[-1].child.name
            itself = last == name and len(first.added) >= len(best.added)
            if (doubted or not itself) and (not explained or self.explains(first)):
                self.say(f"{last} takes its place")
                return first
        if doubted:
            self.say(f"{name} is no longer needed")
        return stays

    def doubted(self, node: Node, named: Added, rest: Node) -> Node | None:
        """The ``rest`` of a node without one of its names, where that would not be believed beside it; else None. Of
        all names the one that gains most beside the others is asked for as if it were the first.
        """
        was = self.known.get(rest.names)
        rest = min([rest, *([was.node] if was else [])], key=lambda n: n.price)
        child = Child(named.child.effect, node.state, rest.state.deviance - node.state.deviance)
        most = max((a.child.gain for a in node.added if a is not named), default=0.0)
        beside = Node(rest.state) if child.gain >= most else rest
        return rest if self.belief.objection(beside, child, Null(named.level, {}, ())) else None

    def explains(self, node: Node) -> bool:
        """Whether a node follows the data, or what is left does not matter to the user; of noise only the null says
        when to stop.
        """
        if self.tolerance_pct > 0.0 and self.belief.stage(node).left_pct <= self.tolerance_pct:
            return True
        if node.added and self.enough(node):
            return True
        return self.evidence.exact and self.belief.stage(node).follows

    def white(self, node: Node) -> bool:
        """Whether what a node leaves is noise."""
        return not node.lacks and self.evidence.white(node.state)

    def expand(self, node: Node, *, rival: Node | None = None, library: Sequence[str] | None = None) -> Iterator[Node]:
        """The nodes with one more effect that the data speak for, the best first; each is finished when asked for.
        Where there is a ``rival`` they have to do as well as it does; a ``library`` stands in for the search's own.
        """
        beside = self.evidence.beside(node.state)
        offered, self.told = beside.offered(self.library if library is None else library)
        if node.added and not self.evidence.exact:  # what another effect leaves can always be blamed on an event
            offered = [e for e in offered if not e.once]
        self.say(f"scoring {len(offered)} effects against the residual of {node.state.fit.model.expression}")
        if not offered:
            return
        found = beside.refitted(offered, self.say, rival=rival.state if rival else None)
        self.told += beside.passed_over()
        accepted, null = self.believed(node, beside, found)
        for c in accepted[: self.settings.beam]:
            yield self.grown(node, c, accepted, null.of(c.name))

    def alone(self, node: Node, found: Sequence[tuple[Effect, State]]) -> Node | None:
        """The node with that one of some effects, each fitted alone, which explains the data, or None. A general curve
        holds what others say and takes up some of the counts: it comes after them.
        """
        self.told = []
        accepted, null = self.believed(node, self.evidence.beside(node.state), found)
        for c in sorted(accepted, key=lambda c: bool(c.effect.points)):
            grown = self.grown(node, c, accepted, null.of(c.name))
            if self.explains(grown):
                return grown
        return None

    def believed(self, node: Node, beside: Beside, found: Sequence[tuple[Effect, State]]) -> tuple[list[Child], Null]:
        """Of the effects ``found`` beside a node those that are believed, the best first, and what chance reaches."""
        against = self.evidence.held_against(node.state, found)
        base = node if against is node.state else Node(against, node.added)
        children = [Child(effect, state, against.deviance - state.deviance) for effect, state in found]
        children.sort(key=lambda c: c.price)
        if not children:
            node.far = True
            return [], Null(0.0, {}, ())
        null = beside.null(children[0].state, lambda null: not any(self.belief.close(c, null) for c in children))
        whys = each(lambda c: self.belief.objection(base, c, null), children)
        accepted = self.belief.in_order([c for c, why in zip(children, whys, strict=True) if why is None])
        beyond = [c for c in children if c.gain > self.belief.asked(c, null)] if not accepted else []
        node.lacks = any(self.belief.surely(base, c) for c in beyond)
        beaten = f"does less well than {accepted[0].name}" if accepted else None
        self.told += [
            Candidate(c.name, c.share, why or (None if c.name == accepted[0].name else beaten))
            for c, why in zip(children, whys, strict=True)
        ]
        return accepted, null

    def expanded(self, node: Node) -> Iterator[Node]:
        """Those nodes as they were found when the same structure was asked for them, unless it does better now."""
        was = self.known.get(node.names)
        if was is not None and (was.node is node or self.evidence.as_good(was.node.state, node.state)):
            node.lacks, node.far, self.told = was.node.lacks, was.node.far, was.told
            yield from was.children
            return
        children: list[Node] = []
        for child in self.expand(node):
            children.append(child)
            yield child
        self.known[node.names] = Expanded(node, tuple(children), self.told)

    def also(self, node: Node, names: Sequence[str]) -> bool:
        """Ask beside a node for other effects too, beside what was found there; whether anything is added to that."""
        was = self.known.get(node.names, Expanded(node, (), []))
        others = tuple(self.expand(node, library=names))
        self.known[node.names] = Expanded(node, (*was.children, *others), [*was.told, *self.told])
        return bool(others)

    def forget_far(self) -> None:
        """Forget what was found beside nodes that no candidate came near the data from."""
        self.known = {names: was for names, was in self.known.items() if not was.node.far}

    def grown(self, node: Node, child: Child, accepted: Sequence[Child], level: float) -> Node:
        """A node with a candidate added, its fit finished, what it no longer needs dropped."""
        self.say(f"adding {child.name}")
        state, dropped = self.needed(self.evidence.finished(child.state), node)
        added = Added(self, child, node, accepted, level)
        added.after = Node(state, (*(a for a in node.added if a.child.name not in dropped), added))
        return added.after

    def needed(self, state: State, node: Node) -> tuple[State, list[str]]:
        """A state without those of a node's effects that the deviance does not ask for any more, or that may as well
        not be there, and which.
        """
        asks, dropped = {a.child.name: self.belief.margin(a.child.effect) * a.level for a in node.added}, []
        for name in [e for e in state.fit.model.effects if e in asks]:
            less = self.evidence.without(state, name)
            asked = max(asks[name], self.settings.equal_deviance)
            if less.deviance - state.deviance < asked or self.evidence.vanishes(state, name):
                self.say(f"{name} is no longer needed")
                state = less
                dropped.append(name)
        return state, dropped

    def found(self, root: Node, node: Node) -> Found[J]:
        """What the search came to: every name with its stage, its evidence and what these data cannot tell from it."""
        stages = tuple(self.belief.stage(n) for n in ((root, node) if node.added else (root,)))
        steps = tuple(a.by.step(a, self.belief.stage(node) if a is node.added[-1] else None) for a in node.added)
        return Found(stages, steps, tuple(self.told), noise=node.state.noise)

    def step(self, added: Added, final: J | None) -> Step[J]:
        """What was added, its stage the ``final`` one or the one just after it."""
        child, before = added.child, added.before
        n = max(child.state.fit.samples, 1.0)
        evidence: dict[str, object] = {
            "residual_power_removed": child.share,
            "by_chance": 1.0 - float(np.exp(-added.level / n)),
            "deviance_gained": child.gain,
            "deviance_by_chance": added.level,
            "missing_torque_follows": self.evidence.follows(before.state),
        }
        rivals = self.belief.rivals(child, added.accepted)
        after = final or self.belief.stage(added.after or before)
        return Step(child.name, after, evidence, named_with(child.name, rivals), rivals)
