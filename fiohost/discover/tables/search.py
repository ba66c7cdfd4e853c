"""Forward selection over tables, as over logs: judge against the floor, try every effect of the library, add, delete.

A candidate is refitted from its trials, must beat what chance can do, and is chosen by the error on rows that were left
out of its fit. Differences below the floor are none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import betaincinv

from fiohost.discover.candidate import Progress
from fiohost.discover.floor import refitted
from fiohost.discover.score import objection
from fiohost.discover.settings import SETTINGS as SEARCH
from fiohost.discover.step import named_with
from fiohost.discover.tables.fit import (
    LOOKS,
    Evidence,
    TableFit,
    fit_declared,
    fit_tables,
    shown_by_one_row,
    without_row,
)
from fiohost.discover.tables.starts import downhill, held
from fiohost.discover.tables.validated import (
    AS_GOOD_LEFT_OUT,
    FAR,
    HOPELESS,
    LEAST_CV_GAIN,
    MOST_EFFECTS,
    Outcome,
    Tried,
    Validated,
    beside,
    checked,
    indistinguishable,
)
from fiohost.discover.workers import each
from fiohost.estimation.intervals import Estimate, estimates
from fiohost.motor.effect import Effect, effect, effects
from fiohost.motor.model import Model

CHANCE = 0.01
REFIT = 6


@dataclass(frozen=True)
class TableStage:
    """A fitted model beside what chance alone would leave of it.

    ``left_out`` are its residuals, one array a row, by the model fitted to the other rows (None: too few of them);
    ``floor_rms`` and ``limit_rms`` are the mean and the top of the errors of replicas, each fitted anew.
    """

    fit: TableFit
    replica_models: tuple[Model, ...]
    floor_rms: float
    limit_rms: float
    left_out: tuple[np.ndarray, ...] | None

    @property
    def at_floor(self) -> bool:
        return self.fit.rms <= self.limit_rms

    @property
    def left_out_rms(self) -> float | None:
        if self.left_out is None:
            return None
        return float(np.sqrt(np.mean(np.concatenate(self.left_out) ** 2)))

    def parameters(self) -> dict[str, Estimate]:
        return estimates(self.fit, self.replica_models)


@dataclass(frozen=True)
class TableStep:
    """One effect that was added, the error on rows left out over that without it, and names it cannot be told from."""

    effect: str
    stage: TableStage
    left_out_ratio: float
    by_chance: float
    indistinguishable_from: tuple[str, ...]


@dataclass(frozen=True)
class TableSearch:
    """What a search found; ``why_not`` says why nothing can be said, where that is so."""

    declared: TableStage
    steps: tuple[TableStep, ...]
    candidates: tuple[Tried, ...]
    why_not: str | None = None

    @property
    def final(self) -> TableStage:
        return self.steps[-1].stage if self.steps else self.declared

    @property
    def verdict(self) -> str:
        if self.why_not is not None:
            return "cannot_be_judged"
        if not self.final.at_floor:
            return "unexplained"
        return "explained" if self.steps else "no_missing_effect"


def parameter_count(evidence: Evidence, fitted: TableFit) -> int:
    """How many numbers the figures had to settle."""
    return int(np.count_nonzero(fitted.seen)) + len(evidence.fitted)


def too_few(evidence: Evidence, fitted: TableFit) -> str | None:
    """Why so many rows cannot judge a model, or None."""
    count, rows = parameter_count(evidence, fitted), len(evidence)
    if rows < count or evidence.samples <= count:
        figures = (
            f"{evidence.samples} figure{'s' if evidence.samples > 1 else ''} in {rows} row{'s' if rows > 1 else ''}"
        )
        return (
            f"{figures} cannot judge a model with {count} parameters to be fitted; measure more rows or fix parameters"
        )
    return None


def can_be_left_out(evidence: Evidence, fitted: TableFit) -> bool:
    """Whether any one row may be left out and the others still settle the parameters."""
    most = max(len(place.row.measured) for place in evidence.places)
    return len(evidence) > 1 and evidence.samples - most >= parameter_count(evidence, fitted)


def left_out(evidence: Evidence, fitted: TableFit, looks: int = 0) -> tuple[np.ndarray, ...]:
    return tuple(without_row(evidence, fitted, row, looks) for row in range(len(evidence)))


def validated(fitted: TableFit, residuals: Sequence[np.ndarray]) -> Validated:
    """Rows left out in turn are both the blocks and the folds."""
    costs = np.array([float(e @ e) for e in residuals])
    return Validated(fitted, costs, costs)


class Search:
    """One search in progress."""

    def __init__(
        self, evidence: Evidence, rng: np.random.Generator, library: Sequence[str] | None, say: Progress
    ) -> None:
        self.evidence, self.rng, self.library, self.say = evidence, rng, library, say

    def stage(self, fitted: TableFit) -> TableStage:
        """A fit judged: replicas of its own figures, rounded elsewhere, are fitted by the same model."""
        noises = [self.evidence.noise(self.rng) for _ in range(SEARCH.floor.replicas)]

        def again(noise: Sequence[np.ndarray]) -> TableFit:
            return fit_tables(self.evidence, fitted.model, constants=fitted.constants, noise=noise, evaluations=REFIT)

        fits = each(again, noises)
        errors = np.array([f.rms for f in fits])
        limit = max(float(errors.mean() + SEARCH.verdict.sigmas * errors.std(ddof=1)), float(errors.max()))
        out = left_out(self.evidence, fitted) if can_be_left_out(self.evidence, fitted) else None
        return TableStage(fitted, tuple(f.model for f in fits), float(errors.mean()), limit, out)

    def offered(self, model: Model) -> tuple[list[Effect], list[Tried]]:
        """Effects to be tried, and those that a table says nothing of."""
        able, unable = [], []
        for item in [effects()[n] for n in (effects() if self.library is None else self.library)]:
            if item.name == "linear" or item.name in model.effects:
                continue
            if item.angle_bound or item.trials_for is not None:
                what = "angle" if item.angle_bound else "time"
                unable.append(Tried(item.name, 0.0, f"a table of readings does not say at which {what}"))
            elif item.trials:
                able.append(item)
        return able, unable

    def refits(self, base: TableFit, offered: Sequence[Effect]) -> list[TableFit | None]:
        """Fits of all candidates, None where one leaves no trace; those far from the best remain rough."""
        starts = each(lambda item: held(self.evidence, base, item), offered)
        near = self.near([min((f.cost for f in found), default=np.inf) for found in starts])
        fits: list[TableFit | None] = [found[0] if found else None for found in starts]
        ways = [(i, start) for i in near for start in starts[i]]
        for (i, _), fitted in zip(ways, each(lambda way: downhill(self.evidence, way[1]), ways), strict=True):
            best = fits[i]
            fits[i] = fitted if best is None or fitted.cost < best.cost else best
        near = self.near([np.inf if f is None else f.cost for f in fits])

        def full(i: int) -> TableFit:
            rough = fits[i]
            assert rough is not None
            return fit_tables(self.evidence, rough.model, constants=rough.constants, looks=LOOKS)

        for i, fitted in zip(near, each(full, near), strict=True):
            fits[i] = fitted
        return fits

    def near(self, costs: Sequence[float]) -> list[int]:
        """Which of these squared errors are not far from the least, or from the floor."""
        return [i for i, cost in enumerate(costs) if cost <= FAR * max(min(costs), self.evidence.samples)]

    def chance(self, base: TableFit, grown: TableFit, tried: int) -> float:
        """Share of the residual's power that the best of all tried takes where only chance is left (beta law)."""
        added = parameter_count(self.evidence, grown) - parameter_count(self.evidence, base)
        free = self.evidence.samples - parameter_count(self.evidence, base)
        if added < 1 or free <= added:
            return 1.0
        return float(betaincinv(0.5 * added, 0.5 * (free - added), (1.0 - CHANCE) ** (1.0 / max(tried, 1))))

    def unbelievable(self, stage: TableStage, item: Effect, grown: TableFit, chance: float) -> str | None:
        """Why a refitted candidate is not even cross-validated, or None."""
        if not can_be_left_out(self.evidence, grown):
            return "its parameters are more than the rows can settle when one of them is left out"
        if shown_by_one_row(grown, item.name):
            return "shows in one row only, which no other row confirms"
        share = 1.0 - grown.cost / max(stage.fit.cost, 1e-300)
        if grown.rms > stage.limit_rms and share <= chance:
            return f"removes {100 * share:.1f} % of the residual's power, chance alone {100 * chance:.1f} %"
        replicas = [refitted(grown, self.evidence.noise(self.rng)) for _ in range(SEARCH.floor.replicas)]
        return objection(grown, item.name, replicas)

    def round(self, stage: TableStage) -> Outcome:
        """Every effect against one stage; the winner, if one is earned."""
        offered, found = self.offered(stage.fit.model)
        self.say(f"trying {len(offered)} effects beside {stage.fit.model.expression}")
        refits = self.refits(stage.fit, offered)
        least = max(min((f.cost for f in refits if f is not None), default=0.0), float(self.evidence.samples))
        base = validated(stage.fit, stage.left_out or ())
        passed: list[tuple[Tried, TableFit]] = []
        for item, grown in zip(offered, refits, strict=True):
            if grown is None:
                found.append(Tried(item.name, 0.0, "leaves no trace in these figures"))
                continue
            candidate = Tried(item.name, 1.0 - grown.cost / max(stage.fit.cost, 1e-300), None)
            why: str | None = f"leaves {np.sqrt(grown.cost / least):.1f} times the error of the best"
            if grown.cost <= HOPELESS * least:
                why = self.unbelievable(stage, item, grown, self.chance(stage.fit, grown, len(offered)))
            if why is not None:
                found.append(replace(candidate, rejected_because=why))
            else:
                passed.append((candidate, grown))
        outs = each(lambda pair: left_out(self.evidence, pair[1]), passed)
        for (candidate, grown), out in zip(passed, outs, strict=True):
            found.append(checked(candidate, validated(grown, out), base))
        able = [(c, c.validated) for c in found if c.validated is not None]
        if not able:
            return Outcome(found)
        best = min(able, key=lambda pair: pair[1].cost)
        equal = [c for c, v in able if self.as_good(v, best[1], base.cost)]
        winner = min(equal, key=lambda c: (len(effect(c.effect).parameters), effect(c.effect).commonness, -c.score))
        return Outcome([beside(c, winner) for c in found], winner, base_cost=base.cost)

    def as_good(self, rival: Validated, best: Validated, base_cost: float) -> bool:
        """Whether a rival does as well on rows left out; an error at the floor is as good as it gets."""
        floor = float(self.evidence.samples)
        return rival.cost <= AS_GOOD_LEFT_OUT * floor or indistinguishable(best, rival, base_cost)

    def rivals(self, outcome: Outcome, stage: TableStage) -> dict[str, Model]:
        """Those that leave no more than chance leaves of the winner, or cannot be told from it by rows left out."""
        winner = outcome.winner
        if winner is None or winner.validated is None:
            return {}
        able = {c.effect: c.validated for c in outcome.candidates if c.validated is not None}
        return {
            name: v.fit.model
            for name, v in able.items()
            if name != winner.effect
            and (v.fit.rms <= stage.limit_rms or self.as_good(v, winner.validated, outcome.base_cost))
        }

    def pruned(self, stage: TableStage, declared: Model) -> TableStage:
        """Without every added effect that rows left out do not miss once the last one is there."""
        for name in [e for e in stage.fit.model.effects[:-1] if e not in declared.effects]:
            less = fit_tables(self.evidence, stage.fit.model.without([name]), constants=stage.fit.constants)
            smaller = self.stage(less)
            if stage.left_out is None or smaller.left_out is None:
                continue
            whole = validated(stage.fit, stage.left_out).cost
            if validated(less, smaller.left_out).cost <= whole * (1.0 + 0.5 * LEAST_CV_GAIN):
                self.say(f"{name} is no longer needed")
                stage = smaller
        return stage


def select(search: Search, model: Model, from_file: bool) -> TableSearch:
    """Forward selection from a declared model."""
    search.say(f"fitting {model.expression} to {len(search.evidence)} rows, {search.evidence.samples} figures")
    fitted = fit_declared(search.evidence, model, keep_start=from_file)
    stage = declared = search.stage(fitted)
    why_not = too_few(search.evidence, fitted)
    if why_not is None and not stage.at_floor and stage.left_out is None:
        why_not = (
            f"{model.expression} does not explain these figures, but their {len(search.evidence)} rows are too few to "
            "leave one out, so nothing can be chosen that it lacks; measure more rows"
        )
    if why_not is not None:
        return TableSearch(declared, (), (), why_not)
    steps: list[TableStep] = []
    candidates: list[Tried] = []
    while not stage.at_floor and stage.left_out is not None and len(steps) < MOST_EFFECTS:
        outcome = search.round(stage)
        candidates, winner = outcome.candidates, outcome.winner
        if winner is None or winner.validated is None or not isinstance(winner.validated.fit, TableFit):
            break
        search.say(f"adding {winner.effect}")
        chance = search.chance(stage.fit, winner.validated.fit, len(candidates))
        grown = search.stage(winner.validated.fit)
        rivals = search.rivals(outcome, grown)
        ratio = float(np.sqrt(winner.validated.cost / validated(stage.fit, stage.left_out).cost))
        stage = search.pruned(grown, model)
        steps = [s for s in steps if s.effect in stage.fit.model.effects]
        steps.append(TableStep(winner.effect, stage, ratio, chance, named_with(winner.effect, rivals)))
    return TableSearch(declared, tuple(steps), tuple(candidates))
