"""One round of the search: every effect of the library against what one stage leaves.

score -> refit the best -> object -> cross-validate -> polish those as good -> choose
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fiohost.discover.choose import CLOSE, Validated, objection, only_at_a_bound, only_in, validate
from fiohost.discover.floor import replica_errors
from fiohost.discover.moments import fit_event, moment_of
from fiohost.discover.refit import finished, fit_anew, full_fit, polish, rough_fit
from fiohost.discover.screen import Score, Screen, candidates, chance_share
from fiohost.discover.stage import LOST, UTTERLY_LOST, Stage
from fiohost.discover.workers import each
from fiohost.estimation.fit import Fit
from fiohost.estimation.record import Record
from fiohost.motor.effect import effect

# Effects are refitted while their score is this share of the best one's, at least and at most so many of them;
# those that come so much farther from the data than the best, in squared error, are not fitted to the end, and those
# that remain so much worse are not cross-validated.
WORTH_REFITTING = 0.1
LEAST_REFITTED, REFITTED = 4, 10
# Beside what is named already, fewer in windows, where each is dear.
REFITTED_BESIDE = 6
FAR, HOPELESS = 12.0, 4.0
# So many begin anew where nothing comes close to the floor; in a first round all, where nothing comes anywhere near it.
REFITTED_ANEW = 16
# Squared errors this close are the same: left out, where single sticks of the shaft make it rugged, and fitted.
AS_GOOD_LEFT_OUT, AS_GOOD_FITTED = 1.1, 1.03
LEAST_CV_GAIN = 0.01
FINISHED = 1.1
# A further effect must account for this share of what still stands above the floor: small remains have many takers.
LEAST_OF_REST = 0.3

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Context:
    """What stays the same in all rounds: the records to fit, the groups of them to leave out, the library; whether one-
    second windows are fitted or whole runs, and whether these are begun anew where nothing else comes close; whether
    there are few experiments, of which scores tell little.
    """

    records: Sequence[Record]
    groups: Sequence[Sequence[int]]
    windows: bool
    anew: bool
    few: bool
    library: Sequence[str] | None
    rng: np.random.Generator
    say: Progress

    def validate(self, fitted: Fit) -> Validated:
        return validate(fitted, self.records, self.groups)


@dataclass(frozen=True)
class Candidate:
    """How one effect did in one round: the share of the residual's power it removed, and why it was not taken.

    ``as_rival`` is of one that could not be taken, for a parameter at its bound, though it does as well as the best.
    """

    effect: str
    score: float
    rejected_because: str | None
    validated: Validated | None = None
    as_rival: Validated | None = None


@dataclass(frozen=True)
class Outcome:
    """A round's candidates, the winner if one is earned, what speaks for it, and the left-out error it began from."""

    candidates: list[Candidate]
    winner: Candidate | None = None
    evidence: Mapping[str, object] = field(default_factory=dict)
    base_cost: float = np.inf

    @property
    def able_beside_winner(self) -> tuple[Candidate, ...]:
        """All that left-out records spoke for as well, the best of them first."""
        able = [(c.validated.cost, c) for c in self.candidates if c.validated is not None and c.effect != self._name]
        return tuple(c for _, c in sorted(able, key=lambda pair: pair[0]))

    @property
    def _name(self) -> str | None:
        return self.winner.effect if self.winner else None


def run_round(context: Context, stage: Stage, first: bool) -> Outcome:
    """Score, refit and cross-validate every candidate around one stage."""
    screen = Screen(stage.fit, context.records)
    offered = candidates(stage.fit.model, context.records, context.library)
    if not (first or stage.lost):  # the little that another effect leaves can always be blamed on an event
        offered = [e for e in offered if not e.once]
    context.say(f"scoring {len(offered)} effects against the residual of {stage.fit.model.expression}")
    scores = sorted(each(screen.score, offered), key=lambda s: s.share, reverse=True)
    if not scores:
        return Outcome([])
    chance = _chance(context, screen, scores)
    scores, refits = _refits(context, stage, scores, first)
    if not refits:
        far = "whole runs stay too far from the floor with every effect"
        return Outcome([Candidate(s.effect.name, s.share, far) for s in scores])
    if context.few and context.windows and first:
        refits = _from_the_best(context, scores, refits)
    believed = [
        f.cost
        for s, f in zip(scores, refits, strict=False)
        if objection(f, s.effect.name) is None and _unconfirmed(context, stage, s, f) is None
    ]
    least = min(believed, default=np.inf)

    def judged(score: Score, fitted: Fit) -> Candidate:
        share = 1.0 - fitted.cost / stage.fit.cost
        why = _objection(context, stage, score, fitted, share, chance, least, first)
        return Candidate(score.effect.name, share, why)

    found = [judged(s, f) for s, f in zip(scores, refits, strict=False)]
    if context.windows:
        near = [i for i, c in enumerate(found) if c.rejected_because is None]
        for i, fitted in zip(near, each(lambda i: finished(refits[i], context.records), near), strict=True):
            refits[i], found[i] = fitted, judged(scores[i], fitted)
    passed = [i for i, c in enumerate(found) if c.rejected_because is None]
    context.say(f"cross-validating {len(passed)} of them")
    alike = [
        i
        for i, c in enumerate(found)
        if c.rejected_because and refits[i].cost <= CLOSE * least and only_at_a_bound(refits[i], c.effect)
    ]
    base = context.validate(stage.fit)
    left_out = each(lambda i: context.validate(refits[i]), [*passed, *alike])
    for i, validated in zip([*passed, *alike], left_out, strict=True):
        found[i] = replace(found[i], as_rival=validated) if i in alike else checked(found[i], validated, base)
    found += [
        Candidate(s.effect.name, s.share, f"scores {100 * s.share:.1f} % of the residual's power, below those refitted")
        for s in scores[len(refits) :]
    ]
    able = [c for c in found if c.validated is not None]
    if not able:
        return Outcome(found)
    best, validated = winner(_finalists(context, able))
    evidence = {
        "residual_power_removed": best.score,
        "by_chance": chance,
        "cross_validated_error_ratio": float(np.sqrt(validated.cost / base.cost)),
    }
    return Outcome([beside(c, best) for c in found], best, evidence, base.cost)


def _chance(context: Context, screen: Screen, scores: Sequence[Score]) -> float:
    """The score that the best of all reaches by chance."""

    def draw(rng: np.random.Generator) -> list[np.ndarray]:
        return replica_errors(screen.fit, context.records, rng, anywhere=True)

    sensors = all(r.quantum > 0 for r in context.records)
    return chance_share(screen, scores, draw if sensors else None, context.rng)


def _refits(context: Context, stage: Stage, scores: Sequence[Score], first: bool) -> tuple[list[Score], list[Fit]]:
    """The scores with those first that were refitted, and their fits; those far from the best remain rough.

    The best are, and those of whose score little can be read: what happened once, between the moments that are tried,
    and what hangs on how warm each log began. None is where all stay far from whole runs, unless they may begin anew.
    """
    most = REFITTED_BESIDE if context.windows and not first else REFITTED
    everyone = context.few and context.windows and first
    worth = [s for s in scores[:most] if s.share > WORTH_REFITTING * scores[0].share]
    worth = list(scores[: max(len(worth), LEAST_REFITTED)] if not everyone else scores)
    context.say(f"refitting the best {len(worth)}")
    worth += [s for s in scores if (s.effect.once or (context.windows and s.effect.warms)) and s not in worth]

    def rough(score: Score) -> Fit:
        fitted = rough_fit(stage.fit, score, context.records)
        if moment_of(score.effect) is None:
            return fitted
        return min(fitted, fit_event(stage.fit, score.effect, context.records), key=lambda f: f.cost)

    fits = each(rough, worth)
    far = LOST if first else UTTERLY_LOST  # beside what is named already, only where all else leads nowhere
    if context.anew and min(f.rms for f in fits) > far * stage.floor_rms:
        context.say("still far from the floor: beginning anew with each of them")
        lost = first and min(f.rms for f in fits) > UTTERLY_LOST * stage.floor_rms
        more = scores if lost else scores[:REFITTED_ANEW]
        worth += [s for s in more if s not in worth]
        anew = each(lambda s: fit_anew(stage.fit, s, context.records), worth)
        fits = [min(pair, key=lambda f: f.cost) for pair in zip(fits, anew, strict=False)] + anew[len(fits) :]
    if not context.windows and not context.anew and min(f.rms for f in fits) > UTTERLY_LOST * stage.floor_rms:
        return list(scores), []
    sure = [f.cost for s, f in zip(worth, fits, strict=True) if _unconfirmed(context, stage, s, f) is None]
    far = HOPELESS if everyone else FAR
    near = [i for i, f in enumerate(fits) if f.cost <= far * min(sure, default=np.inf)]
    far_rms = UTTERLY_LOST * stage.floor_rms
    full = each(lambda i: full_fit(fits[i], worth[i].effect, context.records, far_rms), near)
    for i, fitted in zip(near, full, strict=True):
        fits[i] = fitted
    return [*worth, *(s for s in scores if s not in worth)], fits


def _from_the_best(context: Context, scores: Sequence[Score], refits: Sequence[Fit]) -> list[Fit]:
    """The same fits, or better ones begun with the gain, lag and friction of the best of them: from the declared
    model's own values, far off where few experiments are to be explained, some do not find theirs.
    """
    which = int(np.argmin([f.cost for f in refits]))
    best = refits[which]
    base = replace(best, model=best.model.without([scores[which].effect.name]))

    def better(pair: tuple[Score, Fit]) -> Fit:
        score, fitted = pair
        if score.effect.once or score.effect.warms or fitted is best:
            return fitted
        found = rough_fit(base, score, context.records, window_starts=1)
        if found.cost < min(fitted.cost, HOPELESS * best.cost):
            found = full_fit(found, score.effect, context.records)
        return min(fitted, found, key=lambda f: f.cost)

    return each(better, list(zip(scores, refits, strict=False)))


def _unconfirmed(context: Context, stage: Stage, score: Score, fitted: Fit) -> str | None:
    """Why left-out records cannot speak for an effect that leaves something, or None: what happened once, or what only
    one experiment shows, may be blamed for anything that was peculiar to it.
    """
    left = fitted.rms / stage.floor_rms
    if score.effect.once:
        why = f"an event that happened once and leaves {left:.2f} times the floor cannot be confirmed"
        return why if left > FINISHED else None
    group = None if score.effect.shown else only_in(fitted, score.effect.name, context.groups)
    if group is None or (left := stage.left_of(fitted, group)) <= FINISHED:
        return None
    return f"only {context.records[group[0]].name} shows it, and {left:.2f} times the floor is left there"


def _objection(
    context: Context, stage: Stage, score: Score, fitted: Fit, share: float, chance: float, least: float, first: bool
) -> str | None:
    """Why a refitted candidate is not even cross-validated, or None."""
    left = fitted.rms / stage.floor_rms
    if unconfirmed := _unconfirmed(context, stage, score, fitted):
        return unconfirmed
    above = 1.0 - (left**2 - 1.0) / max((stage.fit.rms / stage.floor_rms) ** 2 - 1.0, 1e-12)
    if not first and above < LEAST_OF_REST:
        return f"removes {100 * max(above, 0.0):.0f} % of what still stands above the floor"
    if share <= chance and left > FINISHED:  # what reaches the floor needs no other proof
        return f"removes {100 * max(share, 0.0):.1f} % of the residual's power, chance alone {100 * chance:.1f} %"
    why = objection(fitted, score.effect.name)
    if why is None and fitted.cost > HOPELESS * least:
        why = f"leaves {np.sqrt(fitted.cost / least):.1f} times the error of the best"
    return why


def checked(candidate: Candidate, validated: Validated, base: Validated) -> Candidate:
    """A cross-validated candidate, rejected where records that were left out do not gain by it."""
    gain = 1.0 - validated.cost / base.cost
    change = validated.fold_costs / np.maximum(base.fold_costs, 1e-300) - 1.0
    if gain < LEAST_CV_GAIN or np.sum(change < -LEAST_CV_GAIN) <= np.sum(change > LEAST_CV_GAIN):
        why = f"changes the error on left-out training records by {-100 * gain:+.1f} % only"
        return replace(candidate, rejected_because=why)
    return replace(candidate, validated=validated)


def _finalists(context: Context, able: Sequence[Candidate]) -> list[tuple[Candidate, Validated]]:
    """Those with the lowest left-out error or as good, their fits polished: a ledge must not decide."""
    checked = [(c, c.validated) for c in able if c.validated is not None]
    least = min(v.cost for _, v in checked)
    close = [(c, v) for c, v in checked if v.cost <= AS_GOOD_LEFT_OUT * least]
    better = [v if context.windows else _polished(c, v, context) for c, v in close]
    return [(replace(c, validated=v), v) for (c, _), v in zip(close, better, strict=True)]


def _polished(candidate: Candidate, validated: Validated, context: Context) -> Validated:
    """The same with its fit polished, unless that only leads to where the effect could not be believed."""
    better = polish(validated.fit, context.records, context.rng)
    return validated if objection(better, candidate.effect) else replace(validated, fit=better)


def winner(finalists: Sequence[tuple[Candidate, Validated]]) -> tuple[Candidate, Validated]:
    """The best fit to all training records decides; among those as good, the simplest, then the commonest."""
    fitted = min(v.fit.cost for _, v in finalists)
    equal = [(c, v) for c, v in finalists if v.fit.cost <= AS_GOOD_FITTED * fitted]
    return min(equal, key=lambda pair: (len(effect(pair[0].effect).parameters), effect(pair[0].effect).commonness))


def beside(candidate: Candidate, winner: Candidate) -> Candidate:
    """A candidate that could have been taken says how it did beside the one that was."""
    if candidate.effect == winner.effect or candidate.validated is None or winner.validated is None:
        return candidate
    ratio = float(np.sqrt(candidate.validated.cost / winner.validated.cost))
    return replace(candidate, rejected_because=f"leaves {ratio:.3g} times the left-out error of {winner.effect}")
