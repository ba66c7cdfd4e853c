"""Forward selection: from a declared model to what it lacks, one effect at a time, on training records alone.

judge against the floor -> evidence -> screen -> refit -> cross-validate -> add -> delete -> polish -> judge again
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fiohost.discover.choose import (
    Validated,
    fit_anew,
    folds,
    full_fit,
    indistinguishable,
    objection,
    polish,
    rough_fit,
    searched_again,
    validate,
)
from fiohost.discover.evidence import dependences
from fiohost.discover.floor import MORE_REPLICAS, REPLICAS, Floor, floors, replica, replica_models
from fiohost.discover.metrics import Judgement, judge, pool
from fiohost.discover.screen import Score, Screen, candidates, chance_share
from fiohost.discover.verdict import Excess, at_floor, excesses, near_limit
from fiohost.discover.workers import each
from fiohost.identify.fit import Fit, fit, fit_from_scratch
from fiohost.identify.record import Record
from fiohost.motor.effect import effect
from fiohost.motor.model import Model

MOST_EFFECTS = 4
# Effects are refitted while their score is this share of the best one's, at least and at most so many of them;
# those that fit so much worse than the best are not cross-validated.
WORTH_REFITTING = 0.1
LEAST_REFITTED, REFITTED = 4, 10
HOPELESS = 4.0
FAR = 12.0
# Where nothing comes closer to the floor than this, the declared fit itself leads nowhere.
LOST = 3.0
REFITTED_ANEW = 16
# Squared errors this close are the same: left out, where single sticks of the shaft make it rugged, and fitted.
AS_GOOD_LEFT_OUT, AS_GOOD_FITTED = 1.1, 1.03
LEAST_CV_GAIN = 0.01
FINISHED = 1.1
# A further effect must account for this share of what still stands above the floor: small remains have many takers.
LEAST_OF_REST = 0.3

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Candidate:
    """How one effect did in one round: the share of the residual's power it removed, and why it was not taken."""

    effect: str
    score: float
    rejected_because: str | None
    validated: Validated | None = None


@dataclass(frozen=True)
class Stage:
    """A fitted model with its judgements on the training records.

    ``replica_models`` are what would have been fitted to replicas of the data: they carry the error of estimation.
    """

    fit: Fit
    replica_models: tuple[Model, ...]
    judgements: tuple[Judgement, ...]
    floors: tuple[Floor, ...]
    excesses: tuple[Excess, ...]

    @property
    def at_floor(self) -> bool:
        return at_floor(self.excesses)


@dataclass(frozen=True)
class Step:
    """One effect that was added, what spoke for it, and the names it cannot be told from.

    ``rival_models`` are the fitted models of those that only this data cannot tell from it.
    """

    effect: str
    stage: Stage
    evidence: dict[str, object]
    indistinguishable_from: tuple[str, ...]
    rival_models: Mapping[str, Model] = field(default_factory=dict)


def _judged(
    fitted: Fit, fitted_records: Sequence[Record], records: Sequence[Record], rng: np.random.Generator
) -> Stage:
    judgements = each(lambda r: judge(r, fitted.model), records)
    names = [r.name for r in records]
    models: list[Model] = []
    for count in (REPLICAS, MORE_REPLICAS):
        models += replica_models(fitted, fitted_records, rng, count)
        found = floors(records, fitted.model, judgements, models, rng)
        above = excesses(names, judgements, found)
        if not near_limit(above):
            break
    return Stage(fitted, tuple(models[:REPLICAS]), tuple(judgements), tuple(found), tuple(above))


def _better(one: Fit, other: Fit) -> Fit:
    return min(one, other, key=lambda f: f.cost)


class Search:
    """One diagnosis in progress over the training records."""

    def __init__(
        self,
        train: Sequence[Record],
        horizon_s: float | None,
        rng: np.random.Generator,
        library: Sequence[str] | None,
        say: Progress,
    ) -> None:
        self.train = train
        self.rng = rng
        self.library = library
        self.say = say
        self.horizon_s = horizon_s
        self.records, self.groups = folds(train, horizon_s)

    def validate(self, fitted: Fit) -> Validated:
        return validate(fitted, self.records, self.groups)

    def stage(self, fitted: Fit) -> Stage:
        return _judged(fitted, self.records, self.train, self.rng)

    def settled(self, fitted: Fit) -> Stage:
        """The stage of a fitted model; off the floor, what an addition may have moved is searched again."""
        stage = self.stage(fitted)
        if (
            stage.at_floor
            or self.horizon_s is not None
            or not any(fitted.model.parameter(n).ragged for n in fitted.names)
        ):
            return stage
        better = searched_again(fitted, self.records)
        return self.stage(better) if better.cost < fitted.cost else stage

    def _chance(self, screen: Screen, scores: Sequence[Score]) -> float:
        def draw(rng: np.random.Generator) -> list[np.ndarray]:
            model = screen.fit.model
            return [
                replica(r, model, s, rng) - (r.y - e)
                for r, s, e in zip(self.records, screen.fit.starts, screen.fit.residuals, strict=True)
            ]

        sensors = all(r.quantum > 0 for r in self.records)
        return chance_share(screen, scores, draw if sensors else None, self.rng)

    def round(self, stage: Stage, first: bool) -> tuple[list[Candidate], Candidate | None, dict[str, object]]:
        """Score, refit and cross-validate every candidate around one stage; the winner, if one is earned."""
        screen = Screen(stage.fit, self.records)
        offered = candidates(stage.fit.model, self.records, self.library)
        if not first:  # the little that another effect leaves can always be blamed on an event
            offered = [e for e in offered if not e.once]
        self.say(f"scoring {len(offered)} effects against the residual of {stage.fit.model.expression}")
        scores = sorted(each(screen.score, offered), key=lambda s: s.share, reverse=True)
        if not scores:
            return [], None, {}
        chance = self._chance(screen, scores)
        worth = [s for s in scores[:REFITTED] if s.share > WORTH_REFITTING * scores[0].share]
        whole = self.horizon_s is None
        worth = scores[: max(len(worth), LEAST_REFITTED) if whole else LEAST_REFITTED]
        self.say(f"refitting the best {len(worth)}")
        pooled = pool([f.errors for f in stage.floors])
        floor = pooled.free_run_rms if pooled and pooled.free_run_rms > 0 else np.inf
        rough = each(lambda s: rough_fit(stage.fit, s, self.records), worth)
        if whole and min(f.rms for f in rough) > LOST * floor:
            self.say("still far from the floor: beginning anew with each of them")
            worth = scores[:REFITTED_ANEW]
            anew = each(lambda s: fit_anew(stage.fit, s, self.records), worth)
            rough = [*map(_better, rough, anew), *anew[len(rough) :]]
        near = [i for i, f in enumerate(rough) if f.cost <= FAR * min(r.cost for r in rough)]
        full = each(lambda i: full_fit(rough[i], scores[i].effect, self.records, search=whole), near)
        refits = [*rough]
        for i, found in zip(near, full, strict=True):
            refits[i] = found
        shares = [1.0 - f.cost / stage.fit.cost for f in refits]
        base = self.validate(stage.fit)
        rejected: list[str | None] = []
        for score, found, share in zip(scores, refits, shares, strict=False):
            why = objection(found, score.effect.name)
            left = float(np.sqrt(found.cost / found.samples)) / floor
            if share <= chance and left > FINISHED:
                why = (
                    f"removes {100 * max(share, 0.0):.1f} % of the residual's power, chance alone {100 * chance:.1f} %"
                )
            above = 1.0 - (left**2 - 1.0) / max((stage.fit.rms / floor) ** 2 - 1.0, 1e-12)
            if not first and above < LEAST_OF_REST:
                why = f"removes {100 * max(above, 0.0):.0f} % of what still stands above the floor"
            if score.effect.once and left > FINISHED:
                why = f"an event that happened once and leaves {left:.2f} times the floor cannot be confirmed"
            rejected.append(why)
        least = min(f.cost for f in refits)
        for i, found in enumerate(refits):
            if rejected[i] is None and found.cost > HOPELESS * least:
                rejected[i] = f"leaves {np.sqrt(found.cost / least):.1f} times the error of the best"
        passed = [i for i, why in enumerate(rejected) if why is None]
        self.say(f"cross-validating {len(passed)} of them")
        checked = dict(zip(passed, each(lambda i: self.validate(refits[i]), passed), strict=True))
        found_all: list[Candidate] = []
        for i, (score, share) in enumerate(zip(scores, shares, strict=False)):
            why = rejected[i]
            validated = checked.get(i)
            if validated is not None:
                gain = 1.0 - validated.cost / base.cost
                change = validated.fold_costs / np.maximum(base.fold_costs, 1e-300) - 1.0
                if gain < LEAST_CV_GAIN or np.sum(change < -LEAST_CV_GAIN) <= np.sum(change > LEAST_CV_GAIN):
                    why = f"changes the error on left-out training records by {-100 * gain:+.1f} % only"
                    validated = None
            found_all.append(Candidate(score.effect.name, share, why, validated))
        found_all += [
            Candidate(
                s.effect.name, s.share, f"scores {100 * s.share:.1f} % of the residual's power, below those refitted"
            )
            for s in scores[len(worth) :]
        ]
        able = [c for c in found_all if c.validated is not None]
        if not able:
            return found_all, None, {}
        winner = self._winner(self._finalists(able))
        found_all = [self._beside(c, winner) for c in found_all]
        evidence: dict[str, object] = {
            "residual_power_removed": winner.score,
            "by_chance": chance,
            "cross_validated_error_ratio": float(np.sqrt(winner.validated.cost / base.cost))
            if winner.validated
            else None,
        }
        return found_all, winner, evidence | {"base_cost": base.cost}

    @staticmethod
    def _beside(candidate: Candidate, winner: Candidate) -> Candidate:
        """A candidate that could have been taken says how it did beside the one that was."""
        if candidate.effect == winner.effect or candidate.validated is None or winner.validated is None:
            return candidate
        ratio = float(np.sqrt(candidate.validated.cost / winner.validated.cost))
        return replace(candidate, rejected_because=f"leaves {ratio:.3g} times the left-out error of {winner.effect}")

    def _finalists(self, able: Sequence[Candidate]) -> list[tuple[Candidate, Validated]]:
        """Those with the lowest left-out error or as good, their fits polished: a ledge must not decide."""
        checked = [(c, c.validated) for c in able if c.validated is not None]
        least = min(v.cost for _, v in checked)
        close = [(c, v) for c, v in checked if v.cost <= AS_GOOD_LEFT_OUT * least]
        better = [replace(v, fit=polish(v.fit, self.records, self.rng)) for _, v in close]
        return [(replace(c, validated=v), v) for (c, _), v in zip(close, better, strict=True)]

    @staticmethod
    def _winner(finalists: Sequence[tuple[Candidate, Validated]]) -> Candidate:
        """The best fit to all training records decides; among those as good, the simplest, then the commonest."""
        fitted = min(v.fit.cost for _, v in finalists)
        equal = [c for c, v in finalists if v.fit.cost <= AS_GOOD_FITTED * fitted]
        return min(equal, key=lambda c: (len(effect(c.effect).parameters), effect(c.effect).commonness))

    def rivals(self, winner: Candidate, able: Sequence[Candidate], base_cost: float) -> dict[str, Model]:
        """Those whose left-out error this data cannot tell from the winner's, as they were fitted."""
        assert winner.validated is not None
        return {
            c.effect: c.validated.fit.model
            for c in able
            if c.effect != winner.effect
            and c.validated is not None
            and indistinguishable(winner.validated, c.validated, base_cost)
        }

    def prune(self, fitted: Fit, declared: Model) -> Fit:
        """Delete every added effect that left-out records do not miss once the others are there."""
        for name in [e for e in fitted.model.effects[:-1] if e not in declared.effects]:
            smaller = fit(fitted.model.without([name]), self.records, starts=fitted.starts)
            whole, less = self.validate(fitted), self.validate(smaller)
            if less.cost <= whole.cost * (1.0 + 0.5 * LEAST_CV_GAIN):
                self.say(f"{name} is no longer needed")
                fitted = smaller
        return fitted


def _above(stage: Stage) -> float:
    """How much power of the one-second windows, all records together, stands above their floor."""
    error, floor = pool([j.errors for j in stage.judgements]), pool([f.errors for f in stage.floors])
    return max(error.window_rms**2 - floor.window_rms**2, 1e-12) if error and floor else 1e-12


@dataclass(frozen=True)
class Found:
    """The outcome of one search: the declared stage first, the final one last."""

    stages: tuple[Stage, ...]
    steps: tuple[Step, ...]
    offered: tuple[Candidate, ...]


def select(search: Search, model: Model, from_file: bool) -> Found:
    """Forward selection from a declared model, with deletion after every addition."""
    stage = declared = search.stage(fit_from_scratch(model, search.records, keep_start=from_file))
    steps: list[Step] = []
    offered: list[Candidate] = []
    while not stage.at_floor and len(steps) < MOST_EFFECTS:
        offered, winner, evidence = search.round(stage, first=not steps)
        if winner is None or winner.validated is None:
            break
        follows = dependences(search.train, stage.fit.model, stage.judgements, search.rng)
        able = [c for c in offered if c.validated is not None]
        base_cost = float(evidence.pop("base_cost"))  # type: ignore[arg-type]
        rivals = search.rivals(winner, able, base_cost)
        names = [n for name in (winner.effect, *rivals) for n in (name, *effect(name).equivalents)]
        names = [n for n in dict.fromkeys(names) if n != winner.effect]
        search.say(f"adding {winner.effect}")
        grown = search.settled(search.prune(winner.validated.fit, model))
        if steps and not grown.at_floor and _above(grown) > (1.0 - LEAST_OF_REST) * _above(stage):
            search.say(f"{winner.effect} leaves the one-second windows as they were: not added")
            rest = (
                f"removes {100 * (1.0 - _above(grown) / _above(stage)):.0f} % of what stands above the floor in windows"
            )
            offered = [replace(c, rejected_because=rest) if c is winner else c for c in offered]
            break
        stage = grown
        evidence["missing_torque_follows"] = {d.variable: d.to_json() for d in follows if d.significant}
        steps = [s for s in steps if s.effect in stage.fit.model.effects]
        steps.append(Step(winner.effect, stage, evidence, tuple(names), rivals))
    return Found((declared, stage) if steps else (declared,), tuple(steps), tuple(offered))
