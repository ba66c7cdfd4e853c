"""Selection where the bench is not exact: by the deviance of windows that are whitened with the noise that is left.

settle noise and model -> score the library -> refit the best, each with its noise -> draw what chance reaches -> accept

Deviance is -2 log restricted likelihood, noise estimated anew for every model. Chance is a parametric bootstrap (Efron
1979): data of the model as it stands, with the noise that the best candidate leaves, through the same sensor, windows
and scores; its level is the best of the whole library at 1 %. Were nothing missing, that noise would be the model's
own. An effect is accepted where it gains more than that, on left-out records too, and no single stretch of the data
carries it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.discover.choose import folds, objection, validate
from fiohost.discover.evidence import dependences
from fiohost.discover.floor import replica_errors
from fiohost.discover.refit import full_fit, rough_fit
from fiohost.discover.round import Candidate, Progress
from fiohost.discover.screen import RESOLUTION_S, Score, Screen, candidates, powers
from fiohost.discover.stage import Stage, judged
from fiohost.discover.step import Found, Step, named_with
from fiohost.discover.whitened import Settled, drawing, plain, settle, with_noise
from fiohost.discover.workers import each
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.record import Record
from fiohost.motor.model import Model
from fiohost.noise.whiten import is_white, unevenness


@dataclass(frozen=True)
class SearchSettings:
    """All numbers of the selection by deviance, each with its reason."""

    # Bootstrap samples that chance is drawn from; the 99 % point of the largest of many is taken from a Gumbel
    # distribution of their mean and spread, for which so many are enough.
    draws: int = 40
    # 99 % point of a Gumbel distribution above its mean, in standard deviations.
    gumbel_sigmas: float = 3.137
    # Refitted, an effect's shape goes where chance is best for it, and its windows fold anew around kinks: an effect
    # has to gain so many times what chance reaches before that.
    margin: float = 1.5
    # So many are refitted, the best scores first, of windows as they are and of whitened ones: where much is missing,
    # the noise takes up what an effect explains.
    refitted: int = 6
    # Of these, so many with the largest gains are settled with noise of their own.
    finalists: int = 4
    # 95 % point of chi-squared for a parameter, with room for the choice among 30: less is not worth a bootstrap.
    least_gain: float = 10.0
    # Left-out blocks speak for an effect, and against a rival, at so many standard errors.
    sure_sigmas: float = 2.0
    # What a stretch of 2 s may count for at most, in deviance: five standard deviations.
    most_of_a_block: float = 25.0
    # A share of the missing torque that follows the angle, the speed or the duty is no noise.
    follows: float = 0.1
    # More effects than these were never told apart.
    most_effects: int = 4


SETTINGS = SearchSettings()


@dataclass(frozen=True)
class Chance:
    """What bootstrap samples of a model reach: the ``level`` of deviance that the best of the library gains, and how
    uneven their whitened residuals are.
    """

    level: float
    unevenness: tuple[float, ...]


@dataclass(frozen=True)
class Finalist:
    """A candidate settled with noise of its own, and by how much its deviance is below that of the model without it."""

    score: Score
    settled: Settled
    gain: float

    @property
    def name(self) -> str:
        return self.score.effect.name

    @property
    def price(self) -> float:
        """Deviance with a price on each parameter (Schwarz 1978)."""
        found = self.settled.fit
        return self.settled.deviance + len(found.names) * float(np.log(max(found.samples, 2.0)))


class Selection:
    """One selection in progress over training records, or over pieces of them where these are few."""

    def __init__(
        self,
        train: Sequence[Record],
        rng: np.random.Generator,
        library: Sequence[str] | None,
        say: Progress,
        settings: SearchSettings = SETTINGS,
    ) -> None:
        self.train, self.rng, self.library, self.say, self.settings = train, rng, library, say, settings
        self.records, self.groups = folds(train)

    def under(self, fitted: Fit, records: Sequence[Record]) -> Fit:
        """A fitted model fitted to other windows of the same records."""
        return fit(fitted.model, records, windows=True, starts=fitted.starts, max_iterations=12, tolerance=1e-5)

    def scores(self, screen: Screen, fitted: Fit, records: Sequence[Record]) -> list[Score]:
        # What happened once no other record can confirm, and noise has stretches that look like it.
        offered = [e for e in candidates(fitted.model, records, self.library) if not e.once]
        return sorted(each(screen.score, offered), key=lambda s: s.share, reverse=True)

    def chance(self, fitted: Fit, records: Sequence[Record]) -> Chance:
        """What chance reaches around a model fitted to whitened windows."""
        screen = Screen(fitted, records)
        scores = self.scores(screen, fitted, records)
        directions = [d for s in scores for d in s.directions]
        basis = np.concatenate(
            [np.empty((len(screen.residual), 0), np.float32), *(d.basis for d in directions)], axis=1
        )
        ends = np.cumsum([d.basis.shape[1] for d in directions])
        edges = [r.windows for r in records]
        # The screen takes samples together: its powers are by so much below deviances.
        block = float(np.mean([max(1, round(RESOLUTION_S / r.sample_time_s)) for r in records]))

        def draw(rng: np.random.Generator) -> tuple[float, float]:
            errors = replica_errors(fitted, records, rng, anywhere=True)
            along = screen.clean(errors).astype(np.float32) @ basis
            parts = zip(np.split(along[None, :], ends[:-1], axis=1)[: len(directions)], directions, strict=True)
            most = max((float(powers(p, d.weights)[0]) for p, d in parts), default=0.0)
            return block * most, unevenness(errors, edges)

        drawn = each(draw, self.rng.spawn(self.settings.draws))
        best = np.array([gain for gain, _ in drawn])
        level = float(best.mean() + self.settings.gumbel_sigmas * best.std(ddof=1))
        return Chance(level, tuple(uneven for _, uneven in drawn))

    def finalists(self, state: Settled) -> tuple[list[Finalist], list[Candidate]]:
        """The best candidates with noise of their own, and why the others are none."""
        bare = plain(self.records)
        loose = self.under(state.fit, bare)
        tight_screen, loose_screen = Screen(state.fit, state.records), Screen(loose, bare)
        tight, wide = self.scores(tight_screen, state.fit, state.records), self.scores(loose_screen, loose, bare)
        most = self.settings.refitted
        worth = [*tight[:most], *(s for s in tight[most:] if s.effect.warms)]
        jobs = [(s, state.fit, state.records) for s in worth]
        jobs += [(s, loose, tuple(bare)) for s in wide[:most]]
        self.say(f"refitting {len({s.effect.name for s, _, _ in jobs})} effects")

        def refit(job: tuple[Score, Fit, tuple[Record, ...]]) -> Fit:
            score, base, records = job
            return full_fit(rough_fit(base, score, records), score.effect, records)

        gains: dict[str, tuple[float, Score, Fit]] = {}
        for (score, base, _), found in zip(jobs, each(refit, jobs), strict=True):
            gain = base.samples * float(np.log(base.cost / max(found.cost, 1e-300)))
            if gain > gains.get(score.effect.name, (-np.inf, score, found))[0]:
                gains[score.effect.name] = (gain, score, found)
        best = sorted(gains.values(), key=lambda g: g[0], reverse=True)

        def settled(item: tuple[float, Score, Fit]) -> Finalist:
            _, score, found = item
            own = settle(found.model, self.records, found.starts, state.moving)
            return Finalist(score, own, state.deviance - own.deviance)

        final = each(settled, best[: self.settings.finalists])
        told = [Candidate(s.effect.name, s.share, "scores less than those refitted") for s in tight]
        told = [c for c in told if c.effect not in gains]
        told += [
            Candidate(s.effect.name, s.share, "gains less than the best of those refitted")
            for _, s, _ in best[self.settings.finalists :]
        ]
        return sorted(final, key=lambda f: f.price), told

    def objection(self, state: Settled, finalist: Finalist, level: float) -> str | None:
        """Why a finalist is not believed, or None."""
        effect, found = finalist.score.effect, finalist.settled
        if finalist.gain < self.settings.margin * level:
            return f"gains {max(finalist.gain, 0.0):.0f} of deviance, chance alone {level:.0f}"
        why = objection(found.fit, effect.name)
        if why is not None:
            return why
        without = validate(self.under(state.fit, found.records), found.records, self.groups)
        gains = self._bounded(without.blocks - validate(found.fit, found.records, self.groups).blocks)
        total, error = float(gains.sum()), float(gains.std(ddof=1)) * np.sqrt(len(gains))
        if total < self.settings.sure_sigmas * error:
            return f"gains {total:.0f} of deviance on left-out training records, give or take {error:.0f}"
        if not effect.shown and total <= 2.0 * float(gains.max()):
            return "is carried by one stretch of 2 s"
        return None

    def _bounded(self, gains: np.ndarray) -> np.ndarray:
        """Gains of blocks, none counting for more than a bound: a window that folded elsewhere decides nothing."""
        most = self.settings.most_of_a_block
        return np.asarray(np.clip(gains, -most, most))

    def rivals(self, first: Finalist, others: Sequence[Finalist]) -> dict[str, Model]:
        """Those that left-out blocks cannot tell from the first, under its noise."""
        records = first.settled.records
        best, found = validate(first.settled.fit, records, self.groups), {}
        for other in others:
            own = self.under(other.settled.fit, records)
            worse = self._bounded(validate(own, records, self.groups).blocks - best.blocks)
            error = float(worse.std(ddof=1)) * np.sqrt(len(worse))
            if float(worse.sum()) < self.settings.sure_sigmas * error:
                found[other.name] = own.model
        return found

    def stage(self, state: Settled) -> Stage:
        return judged(state.fit, state.records, drawing(self.train, state.noise), self.rng)

    def needed(self, state: Settled, declared: Model, level: float) -> Settled:
        """The settled model without what it no longer needs beside what was added last."""
        for name in [e for e in state.fit.model.effects if e not in declared.effects][:-1]:
            less = settle(state.fit.model.without([name]), self.records, state.fit.starts, state.moving)
            if less.deviance - state.deviance < level:
                self.say(f"{name} is no longer needed")
                state = less
        return state


def select_by_deviance(selection: Selection, declared: Fit) -> Found:
    """From a declared model to what it lacks, by deviance under the noise that is left."""
    say, settings = selection.say, selection.settings
    state = settle(declared.model, selection.records, declared.starts)
    first = selection.stage(state)
    steps: list[Step] = []
    told: list[Candidate] = []
    while len(steps) < settings.most_effects:
        say(f"scoring effects by the deviance of {state.fit.model.expression}")
        finalists, told = selection.finalists(state)
        level, taken = np.inf, None
        if finalists and max(f.gain for f in finalists) > settings.least_gain:
            noise = finalists[0].settled.noise
            records = with_noise(plain(selection.records), state.fit.model, noise, state.moving)
            level = selection.chance(selection.under(state.fit, records), records).level
        for finalist in finalists:
            why = selection.objection(state, finalist, level) if level < np.inf else "gains next to nothing"
            taken = finalist if why is None and taken is None else taken
            why = why or (None if finalist is taken else f"less likely than {taken.name if taken else ''}")
            told.append(Candidate(finalist.name, finalist.gain / state.fit.samples, why))
        if taken is None:
            break
        say(f"adding {taken.name}")
        able = [f for f in finalists if f is not taken and selection.objection(state, f, level) is None]
        rivals = selection.rivals(taken, able)
        evidence: dict[str, object] = {
            "residual_power_removed": 1.0 - float(np.exp(-max(taken.gain, 0.0) / state.fit.samples)),
            "by_chance": 1.0 - float(np.exp(-level / state.fit.samples)),
            "deviance_gained": taken.gain,
            "deviance_by_chance": level,
        }
        grown = settle(taken.settled.fit.model, selection.records, taken.settled.fit.starts)
        state = selection.needed(grown, declared.model, level)
        steps = [s for s in steps if s.effect in state.fit.model.effects]
        named = named_with(taken.name, rivals)
        steps.append(Step(taken.name, selection.stage(state), evidence, named, rivals))
    chance = selection.chance(state.fit, state.records)
    uneven = unevenness(state.fit.residuals, [r.windows for r in state.records])
    stages = (first, steps[-1].stage) if steps else (first,)
    final = stages[-1]
    follows = dependences(selection.train, final.fit.model, final.judgements, selection.rng)
    # A random torque follows nothing but itself, in time.
    ruled = any(d.significant and d.r2 > settings.follows and d.variable != "time" for d in follows)
    white = is_white(uneven, chance.unevenness) and not ruled
    return Found(stages, tuple(steps), tuple(told), noise=state.noise, white=white)
