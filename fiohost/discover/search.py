"""Forward selection: from a declared model to what it lacks, one effect at a time, on training records alone.

judge against the floor -> one round over the library -> add -> delete -> search again -> judge again
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.choose import SHARED_GAIN, Validated, folds, indistinguishable, objection
from fiohost.discover.evidence import dependences
from fiohost.discover.exchange import commonest, exchanged, swapped
from fiohost.discover.refit import again, searched_again, unstuck
from fiohost.discover.round import (
    LEAST_CV_GAIN,
    LEAST_OF_REST,
    Candidate,
    Context,
    Outcome,
    Progress,
    run_round,
)
from fiohost.discover.stage import Stage, judged
from fiohost.discover.step import Found, Step, named_with
from fiohost.estimation.fit import Fit, fit, fit_from_scratch
from fiohost.estimation.record import Record
from fiohost.motor.model import Model

MOST_EFFECTS = 4
# Begun anew, no more than a pair is looked for: from two names that are nowhere near the data nothing leads on.
MOST_ANEW = 2
# While effects are chosen among, only each so many windows are looked at, and as many as this at least.
MOST_EVERY, LEAST_WINDOWS = 3, 40
# Something is missing from one-second windows where their power stands by this share above the floor.
SHOWS = 0.05
# A fit may be stuck where they stand above the floor by no more than this.
STUCK = 2.0
# Where structure remains, names are given only if they explain this share of what the declared model leaves.
LEAST_OF_ALL = 0.5


class Search:
    """One search in progress over the training records, by whole runs or by one-second ``windows``.

    Windows are nearly convex and bear with slow disturbances, whole runs are an order of magnitude sharper; ``anew``
    lets candidates begin from values of their own where none comes close to whole runs.
    """

    def __init__(
        self,
        train: Sequence[Record],
        rng: np.random.Generator,
        library: Sequence[str] | None,
        say: Progress,
        *,
        windows: bool = False,
        anew: bool = False,
    ) -> None:
        self.train = train
        records, groups = folds(train)
        if windows:
            every = sum(len(r.windows) - 1 for r in records) // LEAST_WINDOWS
            records = [replace(r, every=max(1, min(every, MOST_EVERY))) for r in records]
        self.context = Context(records, groups, windows, anew, len(records) > len(train), library, rng, say)

    @property
    def records(self) -> Sequence[Record]:
        """What is fitted: the training records, or pieces of them where these are few."""
        return self.context.records

    def stage(self, fitted: Fit) -> Stage:
        """A fit judged; whole runs fitted from where windows led take its place where they are no longer lost."""
        if fitted.windows:
            whole = fit(fitted.model, self.records, max_iterations=25, tolerance=1e-6)
            stage = judged(whole, self.records, self.train, self.context.rng)
            if not stage.lost:
                return stage
        return judged(fitted, self.records, self.train, self.context.rng)

    def settled(self, fitted: Fit) -> Stage:
        """The stage of a fitted model; off the floor, what an addition may have moved is searched again."""
        stage = self.stage(fitted)
        found = stage.fit
        ragged = any(found.model.parameter(n).ragged for n in found.names)
        if stage.at_floor or not ragged or found.windows:
            return stage
        better = searched_again(found, self.records)
        if better.cost >= found.cost or objection(better, better.model.effects[-1]):
            return stage
        return self.stage(better)

    def off_its_ledge(self, stage: Stage, added: bool) -> Stage:
        """The stage, its fit begun again around each parameter if it may stand on a ledge beside its minimum: what
        windows nearly follow and whole runs do not may be no more than that. ``added``: its last effect was, and has to
        stay believable.
        """
        if stage.follows or stage.fit.windows or stage.windows_above_floor > STUCK:
            return stage
        better = unstuck(stage.fit, self.records, self.context.rng)
        if better.cost >= stage.fit.cost or (added and objection(better, better.model.effects[-1])):
            return stage
        return self.stage(better)

    def rivals(self, name: str, best: Validated, outcome: Outcome) -> dict[str, Model]:
        """Those whose left-out error this data cannot tell from that of the one that was taken, as they were fitted."""
        gain = outcome.base_cost - best.cost
        beside = {c.effect: c.validated for c in outcome.candidates if c.validated is not None}
        beside |= {
            c.effect: c.as_rival
            for c in outcome.candidates
            if c.as_rival is not None and outcome.base_cost - c.as_rival.cost >= SHARED_GAIN * gain
        }
        return {
            other: rival.fit.model
            for other, rival in beside.items()
            if other != name and indistinguishable(best, rival, outcome.base_cost)
        }

    def prune(self, fitted: Fit, declared: Model) -> Fit:
        """Delete every added effect that left-out records do not miss once the others are there, fitted again.

        The newest too: it may only have helped the others out of where they were caught.
        """
        added = [e for e in fitted.model.effects if e not in declared.effects]
        for name in added:
            smaller = again(fitted, fitted.model.without([name]), self.records)
            whole, less = self.context.validate(fitted), self.context.validate(smaller)
            if less.cost <= whole.cost * (1.0 + 0.5 * LEAST_CV_GAIN):
                self.context.say(f"{name} is no longer needed")
                fitted = smaller
        return fitted


def _grown(
    search: Search, fitted: Fit, steps: Sequence[Step], declared: Model
) -> tuple[Stage, list[Step], dict[str, str]]:
    """A fit with an effect added, after all that this may have moved: the earlier steps with what takes their place,
    and which names were exchanged for which of their equivalents.
    """
    fitted, swaps = swapped(search.context, fitted, steps, search.stage)
    grown = search.settled(fitted)
    told: dict[str, str] = {}
    if not grown.at_floor:
        fitted, told = exchanged(search.context, fitted, declared)
        grown = search.settled(fitted) if told else grown
    return search.off_its_ledge(grown, True), swaps, told


def _reproach(before: Stage, after: Stage) -> str | None:
    """What speaks against a further effect once it is fitted to the end, or None.

    It has to show in one-second windows too, where there was something to show, and neither figure may rise, whatever
    its floor: a model whose runs scatter has a high one, and stands close to it at any error.
    """
    if any(new > (1.0 + SHOWS) * old for new, old in zip(after.powers, before.powers, strict=False)):
        return "makes whole runs or one-second windows worse"
    if after.follows:
        return None
    was, left = before.powers_above_floor, after.powers_above_floor
    if before.windows_above_floor > SHOWS:
        if left[0] > (1.0 - LEAST_OF_REST) * was[0]:
            return "leaves what stands above the floor in one-second windows as it was"
    elif left[-1] > (1.0 - LEAST_OF_REST) * was[-1]:
        return "leaves what stands above the floor in whole runs as it was"
    return None


def _closer(stage: Stage, other: Stage) -> bool:
    """Whether one stage's fit comes closer than another's; what follows whole runs does so before all windows."""
    if stage.fit.windows != other.fit.windows:
        return other.fit.windows
    return stage.fit.cost < other.fit.cost


def _explained_share(before: Stage, after: Stage) -> float:
    """Share of what stood above the floor that is gone, in whole runs or in one-second windows, whichever is more."""
    pairs = zip(before.powers_above_floor, after.powers_above_floor, strict=False)
    return max((1.0 - left / was for was, left in pairs if was > 0.0), default=0.0)


def declared_alone(search: Search, model: Model, from_file: bool) -> Found:
    """Where every search begins: the declared model fitted to whole runs and judged."""
    stage = search.stage(fit_from_scratch(model, search.records, keep_start=from_file))
    return eased(search, Found((stage,), (), ()))


def eased(search: Search, found: Found) -> Found:
    """What a search came to, its last fit got off its ledge if it may stand on one."""
    stage = search.off_its_ledge(found.final, bool(found.steps))
    if stage is found.final:
        return found
    steps = tuple(replace(s, stage=stage) if s is found.steps[-1] else s for s in found.steps)
    return replace(found, stages=(*found.stages[:-1], stage), steps=steps)


def select(search: Search, begun: Found) -> Found:
    """Forward selection from where another search came to, with deletion after every addition.

    A search by windows ends where whole runs can be followed: what is left then is for a search by whole runs.
    """
    say, rng, windows = search.context.say, search.context.rng, search.context.windows
    declared, stage = begun.stages[0], begun.final
    model = declared.fit.model
    if windows and not stage.fit.windows:
        near = fit(stage.fit.model, search.records, windows=True, max_iterations=25, tolerance=1e-5)
        stage = judged(near, search.records, search.train, rng)
    steps: list[Step] = list(begun.steps)
    offered: list[Candidate] = list(begun.offered)
    while not stage.follows and stage.fit.windows == windows and len(steps) < MOST_EFFECTS:
        if search.context.anew and stage.utterly_lost and len(steps) >= MOST_ANEW:
            break
        outcome = run_round(search.context, stage, first=not steps)
        offered, winner = outcome.candidates, outcome.winner
        if winner is None or winner.validated is None:
            break
        say(f"adding {winner.effect}")
        pruned = search.prune(winner.validated.fit, model)
        if winner.effect not in pruned.model.effects:
            settled, was = search.settled(pruned), stage
            stage = settled if _closer(settled, stage) else stage
            steps = [s for s in steps if s.effect in stage.fit.model.effects]
            if steps:
                steps = [*steps[:-1], replace(steps[-1], stage=stage)]
            elif stage is not was and declared is begun.stages[0]:
                declared = stage
                continue
            unneeded = "is not missed by left-out records once the rest is fitted again"
            offered = [replace(c, rejected_because=unneeded) if c.effect == winner.effect else c for c in offered]
            break
        grown, swaps, told = _grown(search, pruned, steps, model)
        why = _reproach(stage, grown) if steps else None
        if why:
            say(f"{winner.effect} {why}: not added")
            offered = [replace(c, rejected_because=why) if c.effect == winner.effect else c for c in offered]
            break
        follows = dependences(search.train, stage.fit.model, stage.judgements, rng)
        evidence = dict(outcome.evidence)
        evidence["missing_torque_follows"] = {d.variable: d.to_json() for d in follows if d.significant}
        rivals = search.rivals(winner.effect, winner.validated, outcome)
        stage = grown
        steps = [replace(s, effect=told[s.effect], indistinguishable_from=()) if s.effect in told else s for s in swaps]
        steps = [s for s in steps if s.effect in stage.fit.model.effects]
        name = told.get(winner.effect, winner.effect)
        named = named_with(name, rivals) if name == winner.effect else ()
        steps.append(Step(name, stage, evidence, named, rivals, outcome.able_beside_winner, outcome.base_cost))
        if stage.lost and not search.context.windows and not search.context.anew:
            break  # beside a model that whole runs cannot follow, nothing can be told by them
    if steps and not stage.follows and _explained_share(declared, stage) < LEAST_OF_ALL:
        return _all_taken_back(search, declared, steps, offered)
    return Found((declared, stage) if steps else (declared,), tuple(steps), tuple(offered))


def only_commonest(search: Search, found: Found) -> Found:
    """What a search came to that follows nothing: one name is kept, what else is missing has many takers.

    Its parameters are those that windows like best: those of whole runs make up for what wanders from run to run.
    """
    search.context.say("whole runs still cannot be followed: one name is kept, with all that explain not much less")
    only = commonest(found.steps[0], search.stage)
    explained = _explained_share(found.stages[0], only.stage)
    near = fit(only.stage.fit.model, search.records, windows=True, max_iterations=25, tolerance=1e-6)
    by_windows = judged(near, search.records, search.train, search.context.rng)
    if by_windows.powers[0] < only.stage.powers[0]:
        only = replace(only, stage=by_windows)
    if max(explained, _explained_share(found.stages[0], only.stage)) < LEAST_OF_ALL:
        return _all_taken_back(search, found.stages[0], found.steps, found.offered)
    why = "was added, but whole runs cannot be followed with it either"
    return Found((found.stages[0], only.stage), (only,), tuple(_taken_back(found.steps[1:], found.offered, why)))


def _all_taken_back(search: Search, declared: Stage, steps: Sequence[Step], offered: Sequence[Candidate]) -> Found:
    """The declared model alone, where what was added to it leaves most of what stands above the floor."""
    search.context.say("what was added explains less than half: taken back")
    why = "was added, but all that was explains less than half of what stands above the floor"
    return Found((declared,), (), tuple(_taken_back(steps, offered, why)))


def _taken_back(steps: Sequence[Step], offered: Sequence[Candidate], why: str) -> list[Candidate]:
    """The candidates of the last round, and first those that were added, and why they are not any more."""
    names = [s.effect for s in steps]
    back = [Candidate(s.effect, float(str(s.evidence["residual_power_removed"])), why) for s in steps]
    return [*back, *(c for c in offered if c.effect not in names)]
