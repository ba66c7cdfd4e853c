"""How long the horizon is: whole runs where the bench repeats itself to the count, windows where not."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from fiohost.checks.counts import noisy_sensor
from fiohost.discover.candidate import Progress
from fiohost.discover.evidence import State
from fiohost.discover.logs.non_smooth import chosen_again, thorough_fit
from fiohost.discover.logs.one_clock import _by_one_clock
from fiohost.discover.logs.plain_windows import PlainWindows
from fiohost.discover.logs.weighed_windows import WeighedWindows
from fiohost.discover.logs.whitened import drawing, noise_of
from fiohost.discover.logs.whole_runs import WholeRuns
from fiohost.discover.nodes import Node
from fiohost.discover.search import Search
from fiohost.discover.settings import SETTINGS
from fiohost.discover.step import Found
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.record import Record
from fiohost.judging.stage import Stage, judged
from fiohost.motor.effect import Effect, effects
from fiohost.motor.model import Model
from fiohost.noise.estimate import Noise
from fiohost.workers import each

# What only says where to look next; and what only says whether to look on.
GUIDE = replace(SETTINGS, draws=SETTINGS.draws_of_a_guide, most_windows=SETTINGS.windows_of_a_guide)
PROBE = replace(SETTINGS, draws=SETTINGS.draws_of_a_guide)
# Windows have a stream of draws of their own, so that no other draw depends on whether they are needed.
NOISE_SEED = 1


class Ladder:
    """What a declared model lacks: by whole runs; where these cannot be followed, by windows, without what is
    ``hidden`` from the logs; by whole runs again from there. Each rung is a search of its own over the same records.

    With few experiments windows come first: their whole runs have too many local minima. What is left below
    ``tolerance_pct`` of the motion is not asked about.
    """

    def __init__(
        self,
        train: Sequence[Record],
        model: Model,
        library: Sequence[str] | None,
        from_file: bool,
        rng: np.random.Generator,
        say: Progress,
        hidden: Collection[str],
        hardly: Collection[str],
        tolerance_pct: float,
    ) -> None:
        self.train, self.model, self.library, self.from_file = train, model, library, from_file
        self.rng, self.say, self.tolerance_pct = rng, say, tolerance_pct
        names = list(effects() if library is None else library)
        shown = [n for n in names if n not in hidden]
        # All points of a general curve take up a tenth of any slow torque: windows ask for named effects first, and
        # beside noise for no other.
        self.general = [n for n in shown if effects()[n].points]
        self.named = [n for n in shown if n not in self.general]
        self.hardly = [n for n in names if n in hardly and n not in self.general]
        self.exact = not (any(r.broken for r in train) or noisy_sensor(train))
        self.begun_anew = not self.exact
        # Whether few logs, of a shaft that mostly rests, show nothing but counts in windows, and little more whole.
        self.counts_alone = False
        self.windows = WeighedWindows(train, np.random.default_rng(NOISE_SEED))
        self.runs = WholeRuns(train, rng)
        self.whole = Search(self.runs, library, say, tolerance_pct=tolerance_pct, in_vain=self._in_vain)
        self.root = self.whole.declared(model, from_file)
        self._near: WeakKeyDictionary[Node, Node] = WeakKeyDictionary()

    def climbed(self) -> Found[Stage]:
        """What the first rung that explains the data finds, or the last."""
        if self.whole.explains(self.root):
            return self.whole.found(self.root, self.root)
        if self.exact and not self.runs.few:
            best = self.whole.run(self.root, most=SETTINGS.most_before_windows)
            if found := self._by_whole_runs(best) or self._by_plain_windows():
                return found
            if self._at_the_floor(best):
                return self.whole.found(self.root, best)
        elif self.exact and (found := self._each_alone()):
            return found
        return self._by_weighed_windows()

    def _by_whole_runs(self, best: Node) -> Found[Stage] | None:
        if self.whole.explains(best):
            return self.whole.found(self.root, best)
        return _by_one_clock(self.runs, self.library, self.say, self.model, self.from_file)

    def _at_the_floor(self, node: Node) -> bool:
        """Whether what was added leads whole runs to their floor, and what still stands out of it is no noise: then no
        other structure leads lower, whatever noise is blamed.
        """
        reached = bool(node.added) and self.runs.reached(node.state.fit, self.runs.floor_rms(node.state))
        return reached and not self._noise_alone(node)

    def _each_alone(self) -> Found[Stage] | None:
        """Of few logs, the effect that alone leads whole runs to what they can show, or None.

        Their whole runs have too many minima for a search, and their windows too little in them for a score: every
        effect is fitted to windows, and whole runs say which of them follow the data. Of a shaft that mostly rests, no
        whole run tells what windows do not show from a minimum beside the right one.
        """
        self.say("few logs: windows of 1 s, each effect alone")
        guide = PlainWindows(self.train, np.random.default_rng(NOISE_SEED), settings=GUIDE)
        root = guide.declared(self.model, self.from_file)
        near_counts = guide.reached(root.fit, 0.0) and self.runs.near_counts(self.root.state)
        if self.runs.mostly_rests and near_counts:
            self.counts_alone = self.begun_anew = True
            return None
        beside, records = guide.beside(root), self.runs.records
        offered, _ = beside.offered([*self.named, *self.hardly, *self.general])
        alone = beside.each_alone(offered)
        if not any(self.runs.near_counts(state) for _, state in alone):
            return None  # where windows stay far from counts, so do whole runs
        alone = self._followed_at_first(alone)

        def as_whole(of: tuple[Effect, State]) -> tuple[Effect, State]:
            fitted = fit(of[1].fit.model, records, max_iterations=25, tolerance=1e-6)
            return of[0], self.runs.settled(thorough_fit(fitted, of[0], records))

        whole = sorted(each(as_whole, alone), key=lambda w: w[1].deviance)
        near = whole[:1] + [w for w in whole[1:] if self.runs.near_counts(w[1])]
        near.sort(key=lambda w: bool(w[0].points))
        for i, (effect, state) in enumerate(near[: SETTINGS.finalists_in_windows]):
            named = any(self.runs.only_counts(s) for _, s in near[:i])
            as_it_is = self.runs.only_counts(state) and self.runs.mostly_rests
            if not (as_it_is or (effect.points and named)):
                near[i] = effect, self.runs.finished(state)
        led = self.whole.alone(self.root, near)
        return self.whole.found(self.root, led) if led else None

    def _followed_at_first(self, found: list[tuple[Effect, State]]) -> list[tuple[Effect, State]]:
        """Of effects fitted to windows those that lead whole runs as near as any at their beginnings, where logs are so
        long that fits of all would take minutes; none where all stay far from counts there.
        """
        runs = self.runs
        if not runs.long:
            return found
        tried = each(lambda f: fit(f[1].fit.model, runs.beginnings, max_iterations=25, tolerance=1e-6).rms, found)
        least = max(min(tried, default=0.0), runs.most_of_counts)
        if least > SETTINGS.lost * runs.most_of_counts:
            return []
        return [f for f, rms in zip(found, tried, strict=True) if rms**2 <= SETTINGS.hopeless * least**2]

    def _by_plain_windows(self) -> Found[Stage] | None:
        """What whole runs follow where two names lead at most: before more are, noise is asked for."""
        search, root, seen = self._plainly_seen
        best = self._led(seen, SETTINGS.most_before_windows) if seen.added else None
        if not best and seen.added and self._at_the_floor(led := self._finished_whole(seen)):
            return self.whole.found(self.root, led)
        named = seen.added and self.runs.near_counts(seen.state)
        if not best and self.general and not named:
            self.say("general curves over the angle beside them")
            curved = search.run(root) if search.also(root, self.general) else seen
            best = self._led(curved, SETTINGS.most_before_windows) if curved.names - seen.names else None
        if best:
            return self.whole.found(self.root, best)
        # Where windows lead nowhere, or counts are all that they leave, whole runs are begun anew before noise is
        # asked for.
        return self._anew() if search.white(seen) or not (seen.added or self._noise_alone(self.root)) else None

    @cached_property
    def _plainly_seen(self) -> tuple[Search[Stage], Node, Node]:
        """A search in windows as they are, where it began and what it came to."""
        self.say("whole runs stay unexplained: windows of 1 s")
        plain = PlainWindows(self.train, np.random.default_rng(NOISE_SEED), settings=GUIDE)
        search = self._in_windows(plain, self.named, in_vain=lambda n: len(n.added) > 1)
        root = search.declared(self.model, self.from_file)
        return search, root, search.run(root)

    def _plainly_named(self) -> Found[Stage] | None:
        """What windows as they are first led to: beside more noise than any bench has, weights say nothing."""
        search, root, seen = self._plainly_seen
        if not seen.added:
            return None
        found = search.found(root, Node(seen.added[0].child.state, seen.added[:1]))
        return replace(found, offered=tuple(search.known[root.names].told), white=False)

    def _by_weighed_windows(self) -> Found[Stage]:
        """What is believed under the noise that is left, if need be; what whole runs follow from there, if any do."""
        self.say("whole runs stay unexplained: windows of 1 s, under the noise that is left")
        search = self._in_windows(self.windows, [] if self.counts_alone else self.named)
        begun = search.declared(self.model, self.from_file)
        lost = self.windows.no_noise(begun.state)
        if not lost:
            self.__dict__.pop("_plainly_seen", None)  # not asked for again: of a long log it takes much memory
        seen = search.run(begun)
        noise, led = seen.state.noise, seen.added or (self.runs.few and not self.counts_alone)
        # Where a torque at random is all that so many windows leave, no whole run is followed.
        in_vain = self.runs.long and noise is not None and noise.torque_known and search.white(seen)
        if self.exact and led and not in_vain and (best := self._led(seen)):
            return self.whole.found(self.root, best)
        white = search.white(seen)
        ruling = () if white else self.windows.ruling(seen.state)
        found = replace(search.found(begun, seen), white=white, ruling=ruling)
        if found.noise is not None and found.noise.runs.known:
            found = replace(found, taken=self.windows.taken_beside_noise(begun.state, seen.state))
        else:
            found = _plainly_fitted(found, self.windows, self.rng)
        explained = found.white and found.final.follows
        if not (self.begun_anew or explained):
            found = self._anew() or found
        if lost and not (found.steps or self.counts_alone):
            found = self._plainly_named() or found
        return found

    def _anew(self) -> Found[Stage] | None:
        """What explains whole runs where effects begin from values of their own, or None."""
        self.begun_anew = self.runs.anew = True
        self.whole.forget_far()
        best = self.whole.run(self.root)
        self.runs.anew = False
        return self.whole.found(self.root, best) if self.whole.explains(best) else None

    def _in_windows(
        self, windows: PlainWindows, library: Sequence[str], in_vain: Callable[[Node], bool] = lambda node: False
    ) -> Search[Stage]:
        return Search(
            windows, library, self.say, tolerance_pct=self.tolerance_pct, enough=self._enough, in_vain=in_vain
        )

    def _enough(self, node: Node) -> bool:
        """Whether whole runs follow what windows led to."""
        return self.exact and self.whole.explains(self._as_whole_runs(node))

    def _noise_alone(self, node: Node) -> bool:
        """Whether all that a model leaves in windows may be a random torque, or how runs differ: no whole run can be
        followed then.
        """
        probe = WeighedWindows(self.train, np.random.default_rng(NOISE_SEED), PROBE)
        found = probe.settled(fit(node.state.fit.model, probe.plain, windows=True, max_iterations=12))
        known = found.noise is not None and (found.noise.torque_known or found.noise.runs.known)
        return known and probe.white(found)

    def _in_vain(self, node: Node) -> bool:
        """Whether no structure follows whole runs. Beside one name a noise may still be another effect, which windows
        do not tell from it.
        """
        return len(node.added) > 1 and self._noise_alone(node)

    def _as_whole_runs(self, node: Node) -> Node:
        """What windows led to, fitted to whole runs: choices that windows hardly show are made anew there, and what
        comes near the counts is got off its ledge.
        """
        near, runs = self._near, self.runs
        if node not in near:
            fitted = fit(node.state.fit.model, runs.records, max_iterations=25, tolerance=1e-6)
            near[node] = Node(runs.settled(fitted), node.added)
            if not self.whole.explains(near[node]):
                near[node] = Node(runs.settled(chosen_again(fitted, runs.records)), node.added)
            if runs.near_counts(near[node].state) and not self.whole.explains(near[node]):
                near[node] = Node(runs.finished(near[node].state), node.added)
        return near[node]

    def _finished_whole(self, seen: Node) -> Node:
        """What windows led to, carried to its minimum in whole runs."""
        return Node(self.runs.finished(self._as_whole_runs(seen).state), seen.added)

    def _led(self, seen: Node, most: int | None = None) -> Node | None:
        """What explains whole runs from where windows led, with ``most`` effects, some of them added there, or None."""
        again = self._finished_whole(seen)
        if self.whole.explains(again):
            counts_alone = self.runs.only_counts(again.state) and not self.runs.few
            again = self.whole.exchanged(again, root=None if counts_alone else self.root)
        else:
            again = self.whole.run(again, most)
        return again if self.whole.explains(again) else None


def _plainly_fitted(found: Found[Stage], windows: WeighedWindows, rng: np.random.Generator) -> Found[Stage]:
    """What a search came to, models that leave more than noise fitted to windows as they are: weights are right only
    where all that is left is what they are made of. Their own data err by what they leave so.

    Not where runs differ: windows as they are would have one model for all of them.
    """
    noise, steps = found.noise, list(found.steps)

    def plainly(stage: Stage) -> Fit:
        return fit(stage.fit.model, windows.plain, windows=True, starts=stage.fit.starts, tolerance=1e-6)

    def plain(stage: Stage) -> Stage:
        fitted = plainly(stage)
        train = windows.train if noise is None else drawing(windows.train, _left_by(fitted, windows, noise))
        return judged(fitted, windows.plain, train, rng)

    taken = 0.0
    if steps:
        before, after = plainly(found.stages[0]), plainly(found.final)
        taken = 1.0 - after.cost / before.cost if before.cost > 0.0 else 0.0
    stages = list(found.stages)
    if steps or not found.white:
        stages[0] = plain(stages[0])
    if steps and not found.white:
        steps = [replace(s, stage=plain(s.stage)) for s in steps]
        stages[-1] = steps[-1].stage
    return replace(found, stages=tuple(stages), steps=tuple(steps), taken=taken)


def _left_by(fitted: Fit, windows: WeighedWindows, noise: Noise) -> Noise:
    """The noise that a fit to windows as they are leaves, runs differing as they were found to."""
    return replace(noise_of(fitted.model, fitted.starts, windows.plain), runs=noise.runs)
