"""What the library does beside a fit of logs: scored by signatures, the best refitted, roughly and then to the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import zip_longest
from typing import NamedTuple, Protocol

import numpy as np

from fiohost.discover.candidate import Candidate, Progress
from fiohost.discover.evidence import State
from fiohost.discover.moments import fit_event, moment_of
from fiohost.discover.null import Decided, Null, draw_null
from fiohost.discover.optimise import (
    OPTIMISER,
    again,
    begun,
    carried_on,
    cost_of,
    fits_anew,
    gone_on,
    nearest_of,
    thorough_fit,
)
from fiohost.discover.score import objection
from fiohost.discover.screen import Score, Screen, candidates
from fiohost.discover.settings import SearchSettings
from fiohost.discover.within import within_noise
from fiohost.estimation.fit import Fit
from fiohost.estimation.record import Record
from fiohost.motor.effect import Effect
from fiohost.workers import each


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


class LogsBeside:
    """The library beside one state of logs."""

    def __init__(self, logs: Logs, state: State) -> None:
        self.logs, self.state, self.screens = logs, state, logs.screens(state)
        self.ranked: list[list[Score]] = []
        self.taken: set[str] = set()

    def offered(self, library: Sequence[str] | None) -> tuple[list[Effect], list[Candidate]]:
        return candidates(self.state.fit.model, self.logs.records, library, self.screens[0].span), []

    def refitted(
        self, offered: Sequence[Effect], say: Progress, *, rival: State | None = None
    ) -> list[tuple[Effect, State]]:
        # The null asks for the directions of the first screen.
        self.ranked = [ranked(s, offered, s is self.screens[0]) for s in self.screens]
        s, floor = self.logs.settings, self.logs.floor_rms(self.state)
        jobs = self.worth()
        say(f"refitting {len({job.name for job in jobs})} of them")
        jobs, rough = self.rough(jobs, floor, rival)
        if self.logs.exact and min(f.rms for f in rough) > s.lost * floor:
            say("whole runs are far from the floor with every effect")
            if rival or not self.logs.anew:
                return []
            say("beginning anew with each of them")
            first = self.screens[0]
            # Begun from nothing a general curve takes up what any other effect does.
            named = [x for x in self.ranked[0] if not x.effect.points]
            others = fits_anew(first.fit, named, first.records, s.refitted)
            jobs = [Job(named[i], first.fit, first.records) for i, _ in others]
            rough = [found for _, found in others]
            left = min(rough, key=lambda f: f.cost)
            if left.rms > s.lost * floor and left.cost * s.hopeless > first.fit.cost:
                return []  # else it is most of what is missing
        jobs, rough = self.by_every_screen(jobs, rough, floor)
        best = self.carried(jobs, rough, floor, rival)
        states = [(self.state, []), *((state, [name]) for name, (_, state) in best.items())]
        if (
            self.logs.anew
            and not (rival or self.logs.exact)
            and not any(self.leaves_noise(state, names) for state, names in states)
        ):
            say("beside every effect more than noise is left: beginning anew with each of them")
            plain = self.screens[-1]
            others = fits_anew(plain.fit, self.ranked[-1], plain.records, s.finalists_in_windows)
            jobs = [Job(self.ranked[-1][i], plain.fit, plain.records) for i, _ in others]
            for name, found in self.carried(jobs, [found for _, found in others], floor).items():
                if name not in best or found[1].deviance < best[name][1].deviance:
                    best[name] = found
        self.taken = set(best)
        return list(best.values())

    def each_alone(self, offered: Sequence[Effect]) -> list[tuple[Effect, State]]:
        """All effects that can be tried, each fitted whatever its score: what few experiments show of an effect may be
        far from what its signature says. Those that come nowhere near the best one are left out.
        """
        self.ranked = [ranked(s, offered, s is self.screens[0]) for s in self.screens]
        each_of = zip(self.screens, self.ranked, strict=True)
        jobs = [Job(x, screen.fit, screen.records) for screen, scores in each_of for x in scores if x.trials]
        rough = self._some_rough(jobs, np.inf, None, ())
        least = min((f.cost for f in rough), default=0.0)
        near = [(job, f) for job, f in zip(jobs, rough, strict=True) if f.cost <= self.logs.settings.hopeless * least]

        def carried(of: tuple[Job, Fit]) -> tuple[Effect, State]:
            job, found = of[0], carried_on(of[1], of[0].records)
            return job.score.effect, self.logs.settled(thorough_fit(found, job.score.effect, job.records))

        return each(carried, near)

    def completed(self, rival: State | None, name: str) -> State | None:
        """The rival, where it is this state with a name more: whole runs have been carried to their minimum with it."""
        if rival is None or not self.logs.exact:
            return None
        return rival if {*self.state.fit.model.effects, name} == {*rival.fit.model.effects} else None

    def carried(
        self, jobs: Sequence[Job], rough: Sequence[Fit], floor: float, rival: State | None = None
    ) -> dict[str, tuple[Effect, State]]:
        """The best of rough fits carried to their minimum, by name; a ``rival`` stands there already."""
        s = self.logs.settings
        kept = self.finalists(jobs, rough)
        finals = [i for ways in kept for i in ways]
        there = {i: state for i in finals if (state := self.completed(rival, jobs[i].name))}

        def carried(i: int) -> Fit:
            return there[i].fit if i in there else carried_on(rough[i], jobs[i].records)

        fits = dict(zip(finals, each(carried, finals), strict=True))
        in_noise = (
            within_noise(self.logs, self.state, self.screens[0], self.ranked[0], jobs, fits) if self.ranked else {}
        )
        ahead = {id(jobs[i].records): np.inf for i in finals}

        def believed(i: int) -> bool:
            """Whether a fit may stand in the way of others: one at a bound may be a part of what they say."""
            return objection(fits[i], jobs[i].name) is None

        def stands(i: int) -> None:
            """Of two the worse may still come first by a threshold or a choice, but only where it is near."""
            if believed(i):
                ahead[id(jobs[i].records)] = min(ahead[id(jobs[i].records)], OPTIMISER.another_choice * fits[i].cost)

        def thorough(i: int) -> Fit:
            if i in there or i in in_noise or fits[i].cost > ahead[id(jobs[i].records)]:
                return fits[i]
            # Beside one at the floor, others are searched finely only where the coarse search leads them there too.
            at_floor = any(f.rms <= s.finished * floor and believed(k) for k, f in fits.items())
            return thorough_fit(
                fits[i], jobs[i].score.effect, jobs[i].records, (s.finished if at_floor else s.lost) * floor
            )

        for i in finals:
            stands(i)
        if self.logs.exact and finals:  # the best may come to the floor by its thresholds, and then the others need not
            best_one = min(finals, key=lambda i: fits[i].cost)
            fits[best_one] = thorough(best_one)
            stands(best_one)
            finals = [i for i in finals if i != best_one]
        fits |= zip(finals, each(thorough, finals), strict=True)

        def settled(i: int) -> State:
            known = there.get(i) or in_noise.get(i)
            return known or self.logs.settled(fits[i], whitened=jobs[i].records is self.state.records)

        def apart(ways: Sequence[int]) -> Sequence[int]:
            """Of two ways that came to the same, the first."""
            if len(ways) < 2:
                return ways
            one, other = sorted(ways, key=lambda i: jobs[i].records is not self.state.records)
            same = cost_of(fits[other], fits[one].model, jobs[other].records) <= s.as_good * fits[other].cost
            return [one] if same else ways

        left = [i for ways in kept for i in apart(ways)]
        best: dict[str, tuple[Effect, State]] = {}
        for i, state in zip(left, each(settled, left), strict=True):
            if jobs[i].name not in best or state.deviance < best[jobs[i].name][1].deviance:
                best[jobs[i].name] = jobs[i].score.effect, state
        return best

    def in_place_of(self, name: str, library: Sequence[str] | None, say: Progress) -> list[tuple[Effect, State]]:
        """Other effects in the place of one of the state's, begun from where that led the model's other parameters.

        From the declared model no gradient leads to some: under a bridge that opens in each pulse gain and friction are
        far from what they seem. What swings and curves are linear in their sizes: to these scores lead from anywhere.
        """
        screen, s = self.screens[-1], self.logs.settings
        rest = screen.fit.model.without([name])
        ways = [(e, [rest.with_effect(e.name, t) for t in e.tried(screen.span)]) for e in self.offered(library)[0]]
        ways = [(e, models) for e, models in ways if models and not (e.once or e.couples or e.points)]
        if not ways:
            return []
        say(f"trying {len(ways)} others in the place of {name}")
        nearest = each(lambda way: nearest_of(screen.fit, way[1], screen.records), ways)
        order = sorted(range(len(ways)), key=lambda i: nearest[i][0])[: s.finalists_in_windows]
        tried = each(lambda i: again(screen.fit, nearest[i][1], screen.records, 8, 1e-2), order)
        # Only what comes near the one that it is to replace is carried on.
        near = [(i, f) for i, f in zip(order, tried, strict=True) if f.cost <= s.hopeless * screen.fit.cost]
        jobs = [Job(Score(ways[i][0], 0.0, (), ()), screen.fit, screen.records) for i, _ in near]
        return list(self.carried(jobs, [f for _, f in near], self.logs.floor_rms(self.state)).values())

    def leaves_noise(self, state: State, names: Sequence[str]) -> bool:
        """Whether what a state leaves may be noise, and its fit with the effects ``names`` may be believed."""
        return not (self.logs.no_noise(state) or self.logs.degenerate(state, names))

    def worth(self) -> list[Job]:
        """The effects whose scores make them worth a fit, of each screen."""
        s, windows = self.logs.settings, not self.logs.exact
        jobs = []
        for screen, scores in zip(self.screens, self.ranked, strict=True):
            most = s.refitted_in_windows if windows else s.refitted
            begun = [x for x in scores if x.trials]
            worth = [x for x in begun[:most] if x.share > s.worth * scores[0].share]
            worth = begun[: max(len(worth), s.least_refitted)]
            # Around windows as another model begins them, signatures say nothing of what warms or of an end of travel;
            # and little of dry friction, which every drive has, once the gain has taken it up.
            unseen = [x for x in scores if x.effect.unseen_in_windows or x.effect.everywhere] if windows else []
            always = [x for x in scores if x.trials and (x.effect.once or x in unseen)]
            worth += [x for x in always if x not in worth]
            jobs += [Job(x, screen.fit, screen.records) for x in worth]
        return jobs

    def rough(self, jobs: Sequence[Job], floor: float, rival: State | None = None) -> tuple[list[Job], list[Fit]]:
        """The jobs worth one, and their rough fits, without their arrays: of a long log, those of all would fill the
        memory. The best scores come first. Beside one at the floor those that score about as much follow, as the data
        may not tell them from it; none where windows reach it, by which nothing is believed, and where whole runs have
        a ``rival`` or are far from it with all of them. Few experiments may be explained by many effects: all follow.
        Long runs are tried at their beginnings first, and only what follows these is fitted to all.
        """
        s = self.logs.settings
        if self.logs.exact and self.logs.long:
            tried = self._some_rough([job._replace(records=self.logs.beginnings) for job in jobs], floor, None, ())
            least = min((f.rms for f in tried), default=np.inf)
            if least > s.lost * floor:
                return list(jobs), tried
            near = s.hopeless * max(least, floor) ** 2
            jobs = [job for job, f in zip(jobs, tried, strict=True) if f.rms**2 <= near]
        first, rest = list(jobs[: s.least_refitted]), list(jobs[s.least_refitted :])
        found = self._some_rough(first, floor, rival, ())
        least = min((f.rms for f in found), default=np.inf)
        if not self.logs.exact:
            rest = [] if any(self.logs.reached(f, floor) for f in found) else rest
        elif not self.logs.few:
            if rival is not None or least > s.lost * floor:
                rest = []
            elif least**2 <= s.as_good * floor**2:
                rest = [job for job in rest if job.score.share > s.shared_gain * jobs[0].score.share]
        return first + rest, found + self._some_rough(rest, floor, rival, found)

    def _some_rough(self, jobs: Sequence[Job], floor: float, rival: State | None, others: Sequence[Fit]) -> list[Fit]:
        """Rough fits of some jobs; beside one that is at the floor they go on only where they may come near it."""
        if not jobs:
            return []
        s = self.logs.settings
        ahead = each(lambda job: list(map(_bare, begun(job.base, job.score, job.records))), jobs)
        seen = [*(f for fits in ahead for f in fits), *others, *([rival.fit] if rival else [])]
        best = min(seen, key=lambda f: f.cost)
        # A rival in whole runs is at the floor, or it would be none.
        at_floor = self.logs.exact and (rival is not None or self.logs.reached(best, floor))
        most = s.hopeless**2 * best.cost if at_floor else np.inf

        def go_on(i: int) -> Fit:
            job, near = jobs[i], [f for f in ahead[i] if f.cost <= most]
            found = [gone_on(near, job.records) if near else ahead[i][0]]
            if self.logs.exact and not at_floor and moment_of(job.score.effect) is not None:
                found.append(fit_event(job.base, job.score.effect, job.records))
            return _bare(min(found, key=lambda f: f.cost))

        return each(go_on, range(len(jobs)))

    def by_every_screen(self, jobs: Sequence[Job], rough: Sequence[Fit], floor: float) -> tuple[list[Job], list[Fit]]:
        """Jobs and rough fits, those that are to be carried on begun beside every screen: under noise a fit comes to
        other minima than in windows as they are, whichever of the two showed that it is worth one.
        """
        if len(self.screens) < 2:
            return list(jobs), list(rough)
        carried = {jobs[i].name for ways in self.finalists(jobs, rough) for i in ways}
        begun = {(job.name, id(job.records)) for job in jobs}
        others = [
            Job(score, screen.fit, screen.records)
            for screen, scores in zip(self.screens, self.ranked, strict=True)
            for score in scores
            if score.trials and score.effect.name in carried and (score.effect.name, id(screen.records)) not in begun
        ]
        return [*jobs, *others], [*rough, *self._some_rough(others, floor, None, rough)]

    def finalists(self, jobs: Sequence[Job], rough: Sequence[Fit]) -> list[list[int]]:
        """Which are carried to their minimum: of each name the best of each screen."""
        s, windows = self.logs.settings, not self.logs.exact
        bases = [job.base for job in jobs]
        gains = [b.samples * float(np.log(b.cost / max(f.cost, 1e-300))) for b, f in zip(bases, rough, strict=True)]
        order = [int(i) for i in np.argsort(gains)[::-1]]
        # What windows as they are gain says nothing beside what whitened ones do: the best of each in turn.
        sides = [[i for i in order if jobs[i].records is screen.records] for screen in self.screens]
        kept: dict[str, dict[int, int]] = {}
        for i in (i for rank in zip_longest(*sides) for i in rank if i is not None):
            name, way = jobs[i].name, id(jobs[i].records)
            least = min(rough[k].cost for k in order if id(jobs[k].records) == way)
            near = rough[i].cost <= s.hopeless * least
            room = len(kept) < (s.finalists_in_windows if windows else s.finalists)
            if name in kept or (near and (room or (windows and jobs[i].score.effect.everywhere))):
                kept.setdefault(name, {}).setdefault(way, i)
        return [list(ways.values()) for ways in kept.values()]

    def passed_over(self) -> list[Candidate]:
        scores = [s for s in self.ranked[0] if s.effect.name not in self.taken]
        return [Candidate(s.effect.name, s.share, "scores less than those refitted") for s in scores]

    def null(self, best: State, decided: Decided = lambda null: False) -> Null:
        null, first = self.logs.chance(self.state, best), self.screens[0]
        screen, scores = first, self.ranked[0] if self.ranked else ranked(first, self.offered(None)[0], True)
        if null is not self.state:
            screen = Screen(null.fit, null.records, first.span.lines_hz)
            scores = each(screen.score, [s.effect for s in scores])
        return draw_null(null.fit, null.records, screen, scores, self.logs.rng, self.logs.settings, decided)


def _bare(found: Fit) -> Fit:
    """A fit without its arrays."""
    return replace(found, residuals=(), jacobians=(), nuisances=())


def ranked(screen: Screen, offered: Sequence[Effect], directions: bool) -> list[Score]:
    """Effects by their score, the best first; without their ``directions``, which are large, unless they are needed."""

    def scored(effect: Effect) -> Score:
        found = screen.score(effect)
        return found if directions else replace(found, directions=())

    return sorted(each(scored, offered), key=lambda x: x.share, reverse=True)
