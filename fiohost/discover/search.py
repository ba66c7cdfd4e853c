"""The search: a beam over structures, from a declared model to what it lacks, on training records alone.

screen the library -> refit the best -> null -> left-out blocks -> add -> drop what is not needed -> again

Adding and dropping are the moves; with more than one structure carried on, an effect that was mistaken for a part of
another gives way by them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from typing import TypeVar

import numpy as np

from fiohost.discover.candidate import Candidate, Progress
from fiohost.discover.degenerate import core_lost
from fiohost.discover.missing_torque import dependences, ruled
from fiohost.discover.moments import fit_event, moment_of
from fiohost.discover.null import Null, draw_null
from fiohost.discover.objective import Objective, State
from fiohost.discover.optimise import (
    again,
    cost_of,
    fit_anew,
    full_fit,
    polish,
    rough_fit,
    searched_again,
    unstuck,
)
from fiohost.discover.score import Gain, left_out, objection, only_in
from fiohost.discover.screen import Score, Screen, candidates
from fiohost.discover.settings import SETTINGS, SearchSettings
from fiohost.discover.stage import Stage
from fiohost.discover.step import Found, Step, named_with
from fiohost.discover.whitened import drawing
from fiohost.discover.workers import each
from fiohost.estimation.fit import Fit, fit_from_scratch
from fiohost.estimation.record import Record
from fiohost.motor.effect import Effect
from fiohost.motor.model import Model
from fiohost.noise.estimate import Noise
from fiohost.noise.runs import NO_SCATTER, run_of, varied
from fiohost.noise.whiten import is_white, unevenness


@dataclass(frozen=True)
class Child:
    """A candidate carried to its minimum beside a node, and by how much its deviance is below that node's."""

    score: Score
    state: State
    gain: float

    @property
    def name(self) -> str:
        return self.score.effect.name

    @property
    def share(self) -> float:
        """Of the residual's power, as deviance counts it."""
        return 1.0 - float(np.exp(-max(self.gain, 0.0) / max(self.state.fit.samples, 1.0)))

    @property
    def price(self) -> float:
        """That of its state, and on how rare the effect is."""
        return self.state.price + SETTINGS.rare * self.score.effect.commonness

    @property
    def simplicity(self) -> tuple[int, int, float]:
        """How many parameters, how rare, and the price."""
        return len(self.score.effect.parameters), self.score.effect.commonness, self.price


@dataclass(eq=False)
class Node:
    """A structure on the way: its state, what was added in turn to come there, and whether chance does not reach what
    the library gains beside it, though no name is believed.
    """

    state: State
    added: tuple[Added, ...] = ()
    lacks: bool = False
    _stage: Stage | None = field(default=None, repr=False)

    @property
    def names(self) -> frozenset[str]:
        return frozenset(a.child.name for a in self.added)

    @property
    def rarity(self) -> int:
        return sum(a.child.score.effect.commonness for a in self.added)

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

    by: Search
    child: Child
    before: Node
    accepted: Sequence[Child]
    level: float
    after: Node | None = None


Ranked = TypeVar("Ranked", Node, Child)


class Search:
    """One search over one objective; ``anew`` lets candidates begin from values of their own where none comes close,
    ``tolerance_pct`` is the share of the motion that does not matter.
    """

    def __init__(
        self,
        objective: Objective,
        rng: np.random.Generator,
        library: Sequence[str] | None,
        say: Progress,
        settings: SearchSettings = SETTINGS,
        *,
        anew: bool = False,
        tolerance_pct: float = 0.0,
    ) -> None:
        self.anew, self.tolerance_pct = anew, tolerance_pct
        self.objective, self.rng, self.library, self.say, self.settings = objective, rng, library, say, settings
        self.told: list[Candidate] = []
        self._blocks: dict[str, tuple[State, np.ndarray]] = {}

    def stage(self, node: Node) -> Stage:
        """A node judged on whole records, once."""
        if node._stage is None:
            node._stage = self.objective.stage(node.state, self.rng)
        return node._stage

    def declared(self, model: Model, from_file: bool) -> Node:
        """Where every search begins: the declared model fitted."""
        fitted = fit_from_scratch(model, self.objective.records, keep_start=from_file, windows=self.objective.windows)
        return Node(self.finished(self.objective.settled(fitted)))

    def run(self, root: Node) -> Node:
        """The best structure that the data speak for."""
        beam, best = [root], root
        while len(best.added) < self.settings.most_effects and not self.explains(best):
            grown: dict[frozenset[str], Node] = {}
            for node in beam:
                for child in self.expand(node):
                    was = grown.get(child.names)
                    if was is None or child.state.price < was.state.price:
                        grown[child.names] = child
                if not grown and (not self.objective.windows or self.white(node)):
                    break  # beside the best one nothing is missing
            beam = self.best_first(list(grown.values()))[: self.settings.beam]
            if not beam or (best is not root and beam[0].price >= best.price):
                break
            best = next((n for n in beam if self.explains(n)), beam[0])
        return self.exchanged(best)

    def exchanged(self, best: Node) -> Node:
        """A structure with each of its names but the last asked for again beside the others: it was chosen while they
        were missing. Beside what whole runs do not follow nothing can be told by them.
        """
        if not self.objective.windows and not self.explains(best):
            return best
        for earlier in best.added[:-1]:
            if earlier not in best.added:
                continue
            name, fitted = earlier.child.name, best.state.fit
            self.say(f"{name}, asked for again beside the others")
            less = self.objective.settled(again(fitted, fitted.model.without([name]), best.state.records))
            rest = Node(less, tuple(a for a in best.added if a is not earlier))
            told = self.told
            first = self.best_first([*self.expand(rest), best])[0]
            self.told = told
            itself = first is best or first.added[-1].child.name == name
            if not itself and (self.explains(first) or not self.explains(best)):
                self.say(f"{first.added[-1].child.name} takes its place")
                best = first
        return best

    def best_first(self, items: Sequence[Ranked]) -> list[Ranked]:
        """Nodes or children by price; of whole runs, whose counts do not average out, the simplest, then the commonest
        of those that are as good as the best comes first.
        """
        order: list[Ranked] = sorted(items, key=lambda i: i.price)
        if not order or self.objective.windows:
            return order
        least = min(i.state.deviance for i in order)
        tie = least + order[0].state.fit.samples * float(np.log(self.settings.as_good))
        equal = [i for i in order if i.state.deviance <= tie]
        order.insert(0, order.pop(order.index(min(equal, key=lambda i: i.simplicity))))
        return order

    def explains(self, node: Node) -> bool:
        """Whether whole runs follow the data, or what is left does not matter to the user; of noise only the null says
        when to stop.
        """
        if self.tolerance_pct > 0.0 and self.stage(node).left_pct <= self.tolerance_pct:
            return True
        return not self.objective.windows and self.stage(node).follows

    def expand(self, node: Node) -> list[Node]:
        """The nodes with one more effect that the data speak for, the best first."""
        screens = self.objective.screens(node.state)
        span = screens[0].span
        offered = candidates(node.state.fit.model, self.objective.records, self.library, span)
        if node.added:  # the little that another effect leaves can always be blamed on an event
            offered = [e for e in offered if not e.once]
        self.say(f"scoring {len(offered)} effects against the residual of {node.state.fit.model.expression}")
        ranked = [_ranked(s, offered, s is screens[0]) for s in screens]  # the null asks for the first one's directions
        if not offered:
            return []
        children = self.children(node, screens, ranked)
        best = {c.name for c in children}
        self.told = [Candidate(s.effect.name, s.share, "scores less than those refitted") for s in ranked[0]]
        self.told = [c for c in self.told if c.effect not in best]
        if not children:
            return []
        null = self.objective.null(node.state, children[0].state)
        screen = screens[0] if null is node.state else Screen(null.fit, null.records, span.lines_hz)
        scores = ranked[0] if null is node.state else each(screen.score, offered)
        drawn = draw_null(self.objective, null, screen, scores, self.rng, self.settings)
        whys = each(lambda c: self.objection(node, c, drawn), children)
        accepted = self.in_order([c for c, why in zip(children, whys, strict=True) if why is None])
        beyond = [c for c in children if c.gain > self.asked(c, drawn)]
        node.lacks = not accepted and any(self.taken(node, c) >= self.settings.least_further for c in beyond)
        beaten = f"does less well than {accepted[0].name}" if accepted else None
        self.told += [
            Candidate(c.name, c.share, why or (None if c.name == accepted[0].name else beaten))
            for c, why in zip(children, whys, strict=True)
        ]
        return [self.grown(node, c, accepted, drawn.of(c.name)) for c in accepted[: self.settings.beam]]

    def children(self, node: Node, screens: Sequence[Screen], ranked: Sequence[Sequence[Score]]) -> list[Child]:
        """The best candidates, each at its minimum, the least price first."""
        s, windows = self.settings, self.objective.windows
        jobs: list[tuple[Score, Fit, Sequence[Record]]] = []
        for screen, scores in zip(screens, ranked, strict=True):
            most = s.refitted_in_windows if windows else s.refitted
            worth = [x for x in scores[:most] if x.share > s.worth * scores[0].share]
            worth = list(scores[: max(len(worth), s.least_refitted)])
            # Around windows as another model begins them, signatures say nothing of what warms or of an end of travel;
            # and little of dry friction, which every drive has, once the gain has taken it up.
            unseen = [x for x in scores if x.effect.unseen_in_windows or x.effect.everywhere] if windows else []
            always = [x for x in scores if x.trials and (x.effect.once or x in unseen)]
            worth += [x for x in always if x not in worth]
            jobs += [(x, screen.fit, screen.records) for x in worth]
        self.say(f"refitting {len({x.effect.name for x, _, _ in jobs})} of them")
        rough = each(lambda job: self._rough(*job), jobs)
        floor = np.inf if windows else self.stage(node).floor_rms
        if not windows and min(f.rms for f in rough) > s.lost * floor:
            self.say("whole runs are far from the floor with every effect")
            if not self.anew:
                return []
            self.say("beginning anew with each of them")
            jobs = [(x, screens[0].fit, screens[0].records) for x in ranked[0]]
            rough = each(lambda job: fit_anew(job[1], job[0], job[2]), jobs)
            if min(f.rms for f in rough) > s.lost * floor:
                return []
        pairs = [(base, f) for (_, base, _), f in zip(jobs, rough, strict=True)]
        gains = [base.samples * float(np.log(base.cost / max(f.cost, 1e-300))) for base, f in pairs]
        order = [int(i) for i in np.argsort(gains)[::-1]]
        # What windows as they are gain says nothing beside what whitened ones do: the best of each in turn.
        sides = [[i for i in order if jobs[i][2] is screen.records] for screen in screens]
        kept: dict[str, dict[int, int]] = {}  # of each name the best of each screen
        for i in (i for rank in zip_longest(*sides) for i in rank if i is not None):
            name, way = jobs[i][0].effect.name, id(jobs[i][2])
            best_gain = max(gains[k] for k in order if id(jobs[k][2]) == way)
            near = gains[i] >= best_gain - jobs[i][1].samples * np.log(s.hopeless)
            room = len(kept) < (s.finalists_in_windows if windows else s.finalists)
            if name in kept or (near and (room or (windows and jobs[i][0].effect.everywhere))):
                kept.setdefault(name, {}).setdefault(way, int(i))

        def carried(i: int) -> Fit:
            return full_fit(rough[i], jobs[i][0].effect, jobs[i][2], s.lost * floor)

        finals = [i for ways in kept.values() for i in ways.values()]
        fits = dict(zip(finals, each(carried, finals), strict=True))

        def settled(i: int) -> Child:
            state = self.objective.settled(fits[i], whitened=jobs[i][2] is node.state.records)
            return Child(jobs[i][0], state, node.state.deviance - state.deviance)

        def apart(ways: list[int]) -> list[int]:
            """Of two ways that came to the same, the first."""
            if len(ways) < 2:
                return ways
            first, other = sorted(ways, key=lambda i: jobs[i][2] is not node.state.records)
            same = cost_of(fits[other], fits[first].model, jobs[other][2]) <= s.as_good * fits[other].cost
            return [first] if same else ways

        done = each(settled, [i for ways in kept.values() for i in apart(list(ways.values()))])
        best = {name: min((c for c in done if c.name == name), key=lambda c: c.state.deviance) for name in kept}
        return sorted(best.values(), key=lambda c: c.price)

    def _rough(self, score: Score, base: Fit, records: Sequence[Record]) -> Fit:
        """A rough fit without its arrays: of a long log, those of all candidates would fill the memory."""
        found = rough_fit(base, score, records)
        if not self.objective.windows and moment_of(score.effect) is not None:
            found = min(found, fit_event(base, score.effect, records), key=lambda f: f.cost)
        return replace(found, residuals=(), jacobians=(), nuisances=())

    def objection(self, node: Node, child: Child, null: Null) -> str | None:
        """Why a candidate is not believed, or None."""
        s, found, name, of = self.settings, child.state.fit, child.name, child.score.effect
        whole = not self.objective.windows
        left = found.rms / self.stage(node).floor_rms if whole else np.inf
        finished = left <= s.finished
        if whole and of.once and not finished:
            return f"an event that happened once and leaves {left:.2f} times the floor cannot be confirmed"
        if child.gain < self.asked(child, null) and not finished:
            return f"gains {max(child.gain, 0.0):.0f} of deviance, chance alone {null.of(name):.0f}"
        if not self.material(node, child):
            return f"removes {100 * max(self.taken(node, child), 0.0):.0f} % of what windows leave"
        if not whole and self.plainly(node, child):
            return None
        why = next((w for w in (objection(found, n) for n in [name, *node.names]) if w), None)
        why = why or core_lost(child.state.bare or found)  # of noise that is none, weights promise too much
        if why is not None:
            return why
        if whole and node.added:
            above = 1.0 - (left**2 - 1.0) / max((node.state.fit.rms / self.stage(node).floor_rms) ** 2 - 1.0, 1e-12)
            if above < s.least_of_rest:
                return f"removes {100 * max(above, 0.0):.0f} % of what still stands above the floor"
        group = only_in(found, name, self.objective.groups) if not (of.shown or of.once) else None
        if group is not None:
            rest = self.stage(node).left_of(found, group) > s.finished if whole else not self.white(Node(child.state))
            if rest:
                return f"only {self.objective.records[group[0]].name} shows it, and something is left"
        if of.once and finished:
            return None  # no other record can confirm it
        gain = Gain.of(self.left_out(self.objective.under(node.state, child.state), child), self.own(child), s)
        if not gain.sure(s):
            return f"gains {gain.total:.0f} of deviance on left-out training records, give or take {gain.error:.0f}"
        if not of.shown and gain.total <= 2.0 * gain.most:
            return "is carried by one stretch of 2 s"
        return None

    def asked(self, child: Child, null: Null) -> float:
        """The deviance that a candidate has to gain."""
        return self.margin * null.of(child.name)

    @property
    def margin(self) -> float:
        return self.settings.margin_in_windows if self.objective.windows else self.settings.margin

    def taken(self, node: Node, child: Child) -> float:
        """The share of the squared error of windows as they are that a candidate takes."""
        return 1.0 - self.objective.plainly(child.state).cost / max(self.objective.plainly(node.state).cost, 1e-300)

    def material(self, node: Node, child: Child) -> bool:
        """Whether a further effect takes enough of what windows leave to be worth a name."""
        further = self.objective.windows and bool(node.added)
        return not further or self.taken(node, child) >= self.settings.least_further

    def plainly(self, node: Node, child: Child) -> bool:
        """Whether windows as they are speak for a candidate, whatever weights say: where much is missing the noise
        takes up what an effect explains, and what is slow in it most of all. No other record can confirm an event.
        """
        if child.score.effect.once or self.taken(node, child) < self.settings.least_of_rest:
            return False
        before, after = self.objective.plainly(node.state), self.objective.plainly(child.state)
        if any(objection(after, n) for n in [child.name, *node.names]) or core_lost(after):
            return False
        variance, groups = after.cost / max(after.samples, 1.0), self.objective.groups
        records = self.objective.plain
        without, beside = (left_out(f, variance, records, groups) for f in (before, after))
        gain = Gain.of(without, beside, self.settings)
        return gain.sure(self.settings) and gain.total > 2.0 * gain.most

    def left_out(self, fitted: Fit, child: Child) -> np.ndarray:
        """Deviance of left-out blocks of a fit, under the noise that a candidate leaves."""
        return left_out(fitted, child.state.variance, child.state.records, self.objective.groups)

    def own(self, child: Child) -> np.ndarray:
        if child.name not in self._blocks or self._blocks[child.name][0] is not child.state:
            self._blocks[child.name] = (child.state, self.left_out(child.state.fit, child))
        return self._blocks[child.name][1]

    def in_order(self, accepted: Sequence[Child]) -> list[Child]:
        """Candidates, the best first; those of whole runs that are near it are carried to their minimum before."""
        if not self.objective.windows and len(accepted) > 1:
            least = min(c.state.fit.cost for c in accepted)
            near = [c for c in accepted if c.state.fit.cost <= 1.1 * least]
            accepted = [self._polished(c) if c in near else c for c in accepted]
        return self.best_first(accepted)

    def _polished(self, child: Child) -> Child:
        better = polish(child.state.fit, child.state.records, self.rng)
        if better is child.state.fit or objection(better, child.name):
            return child
        state = self.objective.settled(better)
        return Child(child.score, state, child.gain + child.state.deviance - state.deviance)

    def rivals(self, child: Child, accepted: Sequence[Child]) -> dict[str, Model]:
        """Those that left-out blocks cannot tell from a candidate."""
        s, found = self.settings, {}
        for other in (c for c in accepted if c.name != child.name):
            own = self.objective.under(other.state, child.state)
            worse = Gain.of(self.left_out(own, child), self.own(child), s)
            near = not self.objective.windows and other.state.fit.cost <= s.as_good * child.state.fit.cost
            if near or (not worse.sure(s) and other.gain >= s.shared_gain * child.gain):
                found[other.name] = own.model
        return found

    def grown(self, node: Node, child: Child, accepted: Sequence[Child], level: float) -> Node:
        """A node with a candidate added, its fit finished, what it no longer needs dropped."""
        self.say(f"adding {child.name}")
        state, dropped = self.needed(self.finished(child.state), node)
        added = Added(self, child, node, accepted, level)
        added.after = Node(state, (*(a for a in node.added if a.child.name not in dropped), added))
        return added.after

    def finished(self, state: State) -> State:
        """A state with its non-smooth parameters searched again, and got out of a local minimum."""
        if self.objective.windows:
            return state
        found, records = state.fit, self.objective.records
        if any(found.model.parameter(n).ragged for n in found.names) and not self.stage(Node(state)).at_floor:
            better = searched_again(found, records)
            if better.cost < found.cost and not _doubted(better):
                found = better
        state = self.objective.settled(found)
        stage = self.stage(Node(state))
        if stage.follows or stage.windows_above_floor > self.settings.stuck:
            return state
        better = unstuck(found, records, self.rng)
        if better.cost >= found.cost or _doubted(better):
            return state
        return self.objective.settled(better)

    def needed(self, state: State, node: Node) -> tuple[State, list[str]]:
        """A state without those of a node's effects that the deviance does not ask for any more, and which."""
        levels, dropped = {a.child.name: a.level for a in node.added}, []
        for name in [e for e in state.fit.model.effects if e in levels]:
            less = self.objective.settled(again(state.fit, state.fit.model.without([name]), state.records))
            if less.deviance - state.deviance < max(self.margin * levels[name], self.settings.equal_deviance):
                self.say(f"{name} is no longer needed")
                state = less
                dropped.append(name)
        return state, dropped

    def found(self, root: Node, node: Node) -> Found:
        """What the search came to: every name with its stage, its evidence and what these data cannot tell from it."""
        stages = (self.stage(root), self.stage(node)) if node.added else (self.stage(root),)
        steps = tuple(a.by.step(a, self.stage(node) if a is node.added[-1] else None) for a in node.added)
        return Found(stages, steps, tuple(self.told), noise=node.state.noise)

    def step(self, added: Added, final: Stage | None) -> Step:
        """What was added, its stage the ``final`` one or the one just after it."""
        child, before = added.child, self.stage(added.before)
        n = max(child.state.fit.samples, 1.0)
        follows = dependences(self.objective.train, before.fit.model, before.judgements, self.rng)
        evidence: dict[str, object] = {
            "residual_power_removed": child.share,
            "by_chance": 1.0 - float(np.exp(-added.level / n)),
            "deviance_gained": child.gain,
            "deviance_by_chance": added.level,
            "missing_torque_follows": {d.variable: d.to_json() for d in follows if d.significant},
        }
        rivals = self.rivals(child, added.accepted)
        after = final or (self.stage(added.after) if added.after else before)
        return Step(child.name, after, evidence, named_with(child.name, rivals), rivals)

    @property
    def most_torque_pct(self) -> float:
        """A random torque of more than this is no noise."""
        duty = np.concatenate([r.acting_pct for r in self.objective.records])
        return min(self.settings.most_torque_pct, self.settings.most_of_duty * float(np.sqrt(np.mean(duty**2))))

    def white(self, node: Node) -> bool:
        """Whether what a node leaves in windows is noise: white, and followed by nothing."""
        state = node.state
        if state.noise is None or node.lacks or state.noise.torque_pct.value > self.most_torque_pct:
            return False
        null = draw_null(self.objective, state, Screen(state.fit, state.records, ()), [], self.rng, self.settings)
        uneven = unevenness(state.fit.residuals, [r.windows for r in state.records])
        return is_white(uneven, null.unevenness) and not self.ruled(node, state.noise)

    def ruled(self, node: Node, noise: Noise) -> bool:
        """Whether what a node lacks follows anything, each run with what is its own."""
        stage, train = self.stage(node), self.objective.train
        own = [varied(stage.fit.model, noise.runs.by_run.get(run_of(r.name), np.zeros(3))) for r in train]
        records = drawing(train, replace(noise, runs=NO_SCATTER))
        return ruled(records, own, [j.start for j in stage.judgements], self.rng, self.settings)


def _ranked(screen: Screen, offered: Sequence[Effect], directions: bool) -> list[Score]:
    """Effects by their score, the best first; without their ``directions``, which are large, unless they are needed."""

    def scored(effect: Effect) -> Score:
        found = screen.score(effect)
        return found if directions else replace(found, directions=())

    return sorted(each(scored, offered), key=lambda x: x.share, reverse=True)


def _doubted(found: Fit) -> bool:
    """Whether something speaks against the effect that was added last."""
    return any(objection(found, name) for name in found.model.effects[-1:])
