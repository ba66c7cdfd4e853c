"""Forward selection: from a declared model to what it lacks, one effect at a time, on training records alone.

judge against the floor -> one round over the library -> add -> delete -> search again -> judge again
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fiohost.discover.choose import folds, indistinguishable, objection
from fiohost.discover.evidence import dependences
from fiohost.discover.refit import searched_again
from fiohost.discover.round import (
    AS_GOOD_FITTED,
    LEAST_CV_GAIN,
    LEAST_OF_REST,
    Candidate,
    Context,
    Outcome,
    Progress,
    run_round,
)
from fiohost.discover.stage import Stage, judged
from fiohost.estimation.fit import Fit, fit, fit_from_scratch
from fiohost.estimation.record import Record
from fiohost.motor.effect import effect
from fiohost.motor.model import Model

MOST_EFFECTS = 4
# Something is missing from one-second windows where their power stands by this share above the floor.
SHOWS = 0.05
# Where structure remains, names are given only if they explain this share of what the declared model leaves.
LEAST_OF_ALL = 0.5


@dataclass(frozen=True)
class Step:
    """One effect that was added, what spoke for it, and the names it cannot be told from.

    ``rival_models`` are the fitted models of those that only this data cannot tell from it; ``others`` all that could
    have been added in its place, and ``base_cost`` the left-out error they began from.
    """

    effect: str
    stage: Stage
    evidence: dict[str, object]
    indistinguishable_from: tuple[str, ...]
    rival_models: Mapping[str, Model] = field(default_factory=dict)
    others: tuple[Candidate, ...] = ()
    base_cost: float = np.inf


@dataclass(frozen=True)
class Found:
    """The outcome of one search: the declared stage first, the final one last."""

    stages: tuple[Stage, ...]
    steps: tuple[Step, ...]
    offered: tuple[Candidate, ...]


class Search:
    """One search in progress over the training records; ``horizon_s`` cuts them into pieces."""

    def __init__(
        self,
        train: Sequence[Record],
        horizon_s: float | None,
        rng: np.random.Generator,
        library: Sequence[str] | None,
        say: Progress,
    ) -> None:
        self.train = train
        records, groups = folds(train, horizon_s)
        self.context = Context(records, groups, horizon_s is None, library, rng, say)

    @property
    def records(self) -> Sequence[Record]:
        """What is fitted: the training records, or pieces of them."""
        return self.context.records

    def stage(self, fitted: Fit) -> Stage:
        return judged(fitted, self.records, self.train, self.context.rng)

    def settled(self, fitted: Fit) -> Stage:
        """The stage of a fitted model; off the floor, what an addition may have moved is searched again."""
        stage = self.stage(fitted)
        ragged = any(fitted.model.parameter(n).ragged for n in fitted.names)
        if stage.at_floor or not ragged or not self.context.whole:
            return stage
        better = searched_again(fitted, self.records)
        if better.cost >= fitted.cost or objection(better, better.model.effects[-1]):
            return stage
        return self.stage(better)

    def rivals(self, outcome: Outcome) -> dict[str, Model]:
        """Those whose left-out error this data cannot tell from the winner's, as they were fitted."""
        winner = outcome.winner
        if winner is None or winner.validated is None:
            return {}
        return {
            c.effect: c.validated.fit.model
            for c in outcome.candidates
            if c.effect != winner.effect
            and c.validated is not None
            and indistinguishable(winner.validated, c.validated, outcome.base_cost)
        }

    def prune(self, fitted: Fit, declared: Model) -> Fit:
        """Delete every added effect that left-out records do not miss once the others are there, fitted again.

        The newest too where it is not the only one: it may have helped the others out of where they were caught.
        """
        added = [e for e in fitted.model.effects if e not in declared.effects]
        for name in added if len(added) > 1 else []:
            smaller = fit(fitted.model.without([name]), self.records, starts=fitted.starts)
            whole, less = self.context.validate(fitted), self.context.validate(smaller)
            if less.cost <= whole.cost * (1.0 + 0.5 * LEAST_CV_GAIN):
                self.context.say(f"{name} is no longer needed")
                fitted = smaller
        return fitted

    def swap(self, fitted: Fit, steps: Sequence[Step]) -> tuple[Fit, list[Step]]:
        """Put in the place of every earlier effect what could have been added then, where that fits as well and is
        simpler, or fits better: what a later effect explains was mistaken for a part of it.
        """
        kept = list(steps)
        for i, step in enumerate(steps):
            if step.effect not in fitted.model.effects:
                continue
            for other in step.others:
                if other.validated is None or other.effect in fitted.model.effects:
                    continue
                values = {k: v for k, v in other.validated.fit.model.values.items() if k.startswith(other.effect + ".")}
                swapped = fitted.model.with_swapped(step.effect, other.effect, values)
                rival = fit(swapped, self.records, starts=fitted.starts)
                if not better(rival, other.effect, fitted, step.effect):
                    continue
                self.context.say(f"{other.effect} takes the place of {step.effect}")
                evidence = {
                    **step.evidence,
                    "residual_power_removed": other.score,
                    "cross_validated_error_ratio": float(np.sqrt(other.validated.cost / step.base_cost)),
                    "in_place_of": step.effect,
                }
                fitted = rival
                kept[i] = Step(other.effect, self.stage(other.validated.fit), evidence, named_with(other.effect, {}))
                break
        return fitted, kept


def better(rival: Fit, rival_name: str, fitted: Fit, name: str) -> bool:
    """Whether a fit with another effect is to be preferred: clearly closer, or as close and simpler or commoner."""
    if rival.cost > AS_GOOD_FITTED * fitted.cost or objection(rival, rival.model.effects[-1]):
        return False
    if fitted.cost > AS_GOOD_FITTED * rival.cost:
        return True
    ranks = [(len(effect(n).parameters), effect(n).commonness) for n in (rival_name, name)]
    return ranks[0] < ranks[1]


def named_with(winner: str, rivals: Mapping[str, Model]) -> tuple[str, ...]:
    """The names that are said together with a winner: its exact equivalents, its rivals and theirs."""
    names = [n for name in (winner, *rivals) for n in (name, *effect(name).equivalents)]
    return tuple(n for n in dict.fromkeys(names) if n != winner)


def _reproach(before: Stage, after: Stage) -> str | None:
    """What speaks against a further effect once it is fitted to the end, or None.

    It has to show in one-second windows too, where there was something to show, and neither figure may rise, whatever
    its floor: a model whose runs scatter has a high one, and stands close to it at any error.
    """
    if any(new > (1.0 + SHOWS) * old for new, old in zip(after.powers, before.powers, strict=True)):
        return "makes whole runs or one-second windows worse"
    if after.at_floor:
        return None
    (runs, windows), (runs_left, windows_left) = before.powers_above_floor, after.powers_above_floor
    if before.windows_above_floor > SHOWS:
        if windows_left > (1.0 - LEAST_OF_REST) * windows:
            return "leaves what stands above the floor in one-second windows as it was"
    elif runs_left > (1.0 - LEAST_OF_REST) * runs:
        return "leaves what stands above the floor in whole runs as it was"
    return None


def _explained_share(before: Stage, after: Stage) -> float:
    """Share of what stood above the floor that is gone, in whole runs or in one-second windows, whichever is more."""
    pairs = zip(before.powers_above_floor, after.powers_above_floor, strict=True)
    return max((1.0 - left / was for was, left in pairs if was > 0.0), default=0.0)


def select(search: Search, model: Model, from_file: bool) -> Found:
    """Forward selection from a declared model, with deletion after every addition."""
    say, rng = search.context.say, search.context.rng
    stage = declared = search.stage(fit_from_scratch(model, search.records, keep_start=from_file))
    steps: list[Step] = []
    offered: list[Candidate] = []
    while not stage.at_floor and len(steps) < MOST_EFFECTS:
        outcome = run_round(search.context, stage, first=not steps)
        offered, winner = outcome.candidates, outcome.winner
        if winner is None or winner.validated is None:
            break
        say(f"adding {winner.effect}")
        pruned = search.prune(winner.validated.fit, model)
        if winner.effect not in pruned.model.effects:
            again = search.settled(pruned)
            stage = again if again.fit.cost < stage.fit.cost else stage
            steps = [s for s in steps if s.effect in stage.fit.model.effects]
            steps = [*steps[:-1], replace(steps[-1], stage=stage)]
            unneeded = "is not missed by left-out records once the rest is fitted again"
            offered = [replace(c, rejected_because=unneeded) if c.effect == winner.effect else c for c in offered]
            break
        pruned, steps = search.swap(pruned, steps)
        grown = search.settled(pruned)
        why = _reproach(stage, grown) if steps else None
        if why:
            say(f"{winner.effect} {why}: not added")
            offered = [replace(c, rejected_because=why) if c.effect == winner.effect else c for c in offered]
            break
        follows = dependences(search.train, stage.fit.model, stage.judgements, rng)
        evidence = dict(outcome.evidence)
        evidence["missing_torque_follows"] = {d.variable: d.to_json() for d in follows if d.significant}
        rivals = search.rivals(outcome)
        stage = grown
        steps = [s for s in steps if s.effect in stage.fit.model.effects]
        named = named_with(winner.effect, rivals)
        steps.append(Step(winner.effect, stage, evidence, named, rivals, outcome.able_beside_winner, outcome.base_cost))
    if steps and not stage.at_floor and _explained_share(declared, stage) < LEAST_OF_ALL:
        say("what was added explains less than half: taken back")
        return Found((declared,), (), tuple(_taken_back(steps, offered)))
    return Found((declared, stage) if steps else (declared,), tuple(steps), tuple(offered))


def _taken_back(steps: Sequence[Step], offered: Sequence[Candidate]) -> list[Candidate]:
    """The candidates of the last round, and first those that were added but explain too little together."""
    why = "was added, but all that was explains less than half of what stands above the floor"
    names = [s.effect for s in steps]
    back = [Candidate(s.effect, float(str(s.evidence["residual_power_removed"])), why) for s in steps]
    return [*back, *(c for c in offered if c.effect not in names)]
