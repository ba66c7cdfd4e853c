"""The best of rough fits, carried to their minimum."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from fiohost.discover.evidence import State
from fiohost.discover.logs.job import Job, Logs
from fiohost.discover.logs.non_smooth import thorough_fit
from fiohost.discover.logs.optimise import OPTIMISER, carried_on, cost_of
from fiohost.discover.logs.scores import Score
from fiohost.discover.logs.screen import Screen
from fiohost.discover.logs.within import under_noise_of, within_noise
from fiohost.discover.score import objection
from fiohost.estimation.fit import Fit
from fiohost.motor.effect import Effect
from fiohost.workers import each


class Finals:
    """Which rough fits beside a ``state`` of logs are carried to their minimum, and what they come to there."""

    def __init__(self, logs: Logs, state: State, screens: Sequence[Screen], ranked: Sequence[Sequence[Score]]) -> None:
        """``ranked`` are the scores around each of the ``screens``; none where nothing was scored."""
        self.logs, self.state, self.screens, self.ranked = logs, state, screens, ranked

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
            # Where something else is missing besides, a threshold's last digits say nothing.
            at_floor = any(f.rms <= s.finished * floor and believed(k) for k, f in fits.items())
            return thorough_fit(
                fits[i], jobs[i].score.effect, jobs[i].records, (s.finished if at_floor else s.stuck) * floor
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

        def likely(i: int, state: State) -> State:
            """No model is less likely than one it holds: if it seems so, the noise of steady motion is too small."""
            holds = set(self.state.fit.model.effects) <= set(state.fit.model.effects)
            too_small = state.noise is not None and state.variance > 1.0 and state.deviance > self.state.deviance
            if not (holds and too_small):
                return state
            return min(state, under_noise_of(self.state, fits[i], jobs[i].records), key=lambda s: s.deviance)

        def apart(ways: Sequence[int]) -> Sequence[int]:
            """Of two ways that came to the same, the first."""
            if len(ways) < 2:
                return ways
            one, other = sorted(ways, key=lambda i: jobs[i].records is not self.state.records)
            same = cost_of(fits[other], fits[one].model, jobs[other].records) <= s.as_good * fits[other].cost
            return [one] if same else ways

        left = [i for ways in kept for i in apart(ways)]
        best: dict[str, tuple[int, State]] = {}
        for i, state in zip(left, each(settled, left), strict=True):
            if jobs[i].name not in best or state.deviance < best[jobs[i].name][1].deviance:
                best[jobs[i].name] = i, state
        states = each(lambda of: likely(*of), list(best.values()))
        effects = (jobs[i].score.effect for i, _ in best.values())
        return dict(zip(best, zip(effects, states, strict=True), strict=True))
