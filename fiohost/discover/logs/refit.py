"""What the library does beside a fit of logs: scored by signatures, the best refitted, roughly and then to the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.candidate import Candidate, Progress
from fiohost.discover.evidence import State
from fiohost.discover.logs.bootstrap import draw_null
from fiohost.discover.logs.finals import Finals
from fiohost.discover.logs.job import Job, Logs
from fiohost.discover.logs.non_smooth import thorough_fit
from fiohost.discover.logs.offered import candidates
from fiohost.discover.logs.optimise import again, carried_on, fits_anew, nearest_of
from fiohost.discover.logs.rough import rough_fits, some_rough
from fiohost.discover.logs.scores import Score
from fiohost.discover.logs.screen import Screen
from fiohost.discover.null import Decided, Null
from fiohost.estimation.fit import Fit
from fiohost.motor.effect import Effect
from fiohost.workers import each


class LogsBeside:
    """The library beside one state of logs."""

    def __init__(self, logs: Logs, state: State) -> None:
        self.logs, self.state, self.screens = logs, state, logs.screens(state)
        self.ranked: list[list[Score]] = []
        self.taken: set[str] = set()

    @property
    def finals(self) -> Finals:
        return Finals(self.logs, self.state, self.screens, self.ranked)

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
        jobs, rough = rough_fits(self.logs, jobs, floor, rival)
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
        best = self.finals.carried(jobs, rough, floor, rival)
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
            for name, found in self.finals.carried(jobs, [found for _, found in others], floor).items():
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
        rough = some_rough(self.logs, jobs, np.inf, None, ())
        least = min((f.cost for f in rough), default=0.0)
        near = [(job, f) for job, f in zip(jobs, rough, strict=True) if f.cost <= self.logs.settings.hopeless * least]

        def carried(of: tuple[Job, Fit]) -> tuple[Effect, State]:
            job, found = of[0], carried_on(of[1], of[0].records)
            return job.score.effect, self.logs.settled(thorough_fit(found, job.score.effect, job.records))

        return each(carried, near)

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
        return list(self.finals.carried(jobs, [f for _, f in near], self.logs.floor_rms(self.state)).values())

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

    def by_every_screen(self, jobs: Sequence[Job], rough: Sequence[Fit], floor: float) -> tuple[list[Job], list[Fit]]:
        """Jobs and rough fits, those that are to be carried on begun beside every screen: under noise a fit comes to
        other minima than in windows as they are, whichever of the two showed that it is worth one.
        """
        if len(self.screens) < 2:
            return list(jobs), list(rough)
        carried = {jobs[i].name for ways in self.finals.finalists(jobs, rough) for i in ways}
        begun = {(job.name, id(job.records)) for job in jobs}
        others = [
            Job(score, screen.fit, screen.records)
            for screen, scores in zip(self.screens, self.ranked, strict=True)
            for score in scores
            if score.trials and score.effect.name in carried and (score.effect.name, id(screen.records)) not in begun
        ]
        return [*jobs, *others], [*rough, *some_rough(self.logs, others, floor, None, rough)]

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


def ranked(screen: Screen, offered: Sequence[Effect], directions: bool) -> list[Score]:
    """Effects by their score, the best first; without their ``directions``, which are large, unless they are needed."""

    def scored(effect: Effect) -> Score:
        found = screen.score(effect)
        return found if directions else replace(found, directions=())

    return sorted(each(scored, offered), key=lambda x: x.share, reverse=True)
