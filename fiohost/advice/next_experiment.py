"""The experiment to run next: the one that tells apart what these data cannot, or shows what they do not.

Every experiment of a menu is simulated with the model that was chosen and with each rival, both as they were fitted.
The rival is then fitted again to what the chosen model would give there, as far as the old data let it (one step on
both together, then a whole fit for those that promise most); what still differs, over the error that is left anyway,
is the separation. Designs that tell rival models apart: Hunter and Reiner, Technometrics 7, 1965.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiohost.checks.excitation import lacks
from fiohost.checks.exercised import Exercised
from fiohost.discover.logs.folds import folds
from fiohost.discover.settings import SETTINGS as SEARCH
from fiohost.discover.step import Step
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import ANGLE, Record, make_record
from fiohost.judging.metrics import judge, pool
from fiohost.judging.stage import Stage
from fiohost.motor.effect import Value, effect
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.workers import each

# Differences over the floor: below the first an experiment does not separate; beyond the second more is not better.
SEPARATES, DECISIVE = 1.5, 10.0
MOST_RIVALS = 6
REFIT_STEPS, TOLERANCE = 8, 1e-3
MOST_CONFIRMED = 4
NOT_A_STEP = 1e12

SHOWS = {
    "angle": "turns_slow",
    "time": "soak",
    "duty": "ramp_full",
    "speed": "ramp_full",
    "speed_sign": "triangle_slow",
}
OTHERWISE = "multisine"
# For benches that this program does not drive: what the experiments of the menu do.
IN_WORDS = {
    "staircase": "hold the command at rising and falling levels in both directions, each until the speed has settled",
    "pulses": "short pulses of several sizes from standstill, in both directions",
    "multisine": "a sum of sines of several frequencies, large enough to turn the shaft both ways",
    "multisine_fast": "a sum of sines up to the highest frequency that still moves the shaft",
    "triangle_slow": "raise and lower the command slowly through zero, several times, so that the shaft reverses",
    "sine_slow": "a slow sine through zero, several periods",
    "sines_small": "small sines around zero, just enough to move the shaft",
    "reversals": "reverse the direction again and again at several speeds",
    "turns_slow": "turn the shaft (or move the axis) slowly over its whole travel, forward and back, at least twice",
    "starts_slow": "start from rest many times with a command that rises slowly",
    "steps_from_rest": "steps of several sizes from standstill, in both directions, each with a rest before it",
    "coast": "bring the shaft to speed and let it coast to rest with the bridge off",
    "ramp_full": "a slow ramp from zero to full command and back, in both directions",
    "soak": "hold one command for minutes, twice, with a pause between",
}


@dataclass(frozen=True)
class Offer:
    """An experiment that could be run: commands (n) of it from its beginning, duty in percent and mode as in a log."""

    name: str
    title: str
    times_s: np.ndarray
    duty_pct: np.ndarray
    modes: np.ndarray

    @property
    def seconds(self) -> float:
        return float(self.times_s[-1] - self.times_s[0])


@dataclass(frozen=True)
class Separation:
    """By how many times the floor each rival would differ in one experiment, after it was fitted again."""

    experiment: str
    seconds: float
    over_floor: Mapping[str, float]

    @property
    def least(self) -> float:
        return min(self.over_floor.values())


@dataclass(frozen=True)
class NextExperiment:
    """What to run next and why; ``experiment`` is None where no experiment of the menu separates the rivals, and tells
    what to do where it is ``in_words``.
    """

    why: str
    experiment: str | None
    rivals: tuple[str, ...] = ()
    separations: tuple[Separation, ...] = ()
    in_words: bool = False

    def for_another_bench(self) -> NextExperiment:
        """The same for a bench that this program does not drive: what to do, in words."""
        if self.experiment is None:
            return self
        words = IN_WORDS.get(self.experiment, self.experiment)
        return replace(self, why=self.why.partition(": ")[0], experiment=words, in_words=True)

    def to_json(self) -> dict[str, object] | None:
        if self.experiment is None:
            return None
        return {"why": self.why, "experiment": self.experiment, "in_words": self.in_words}

    def separation_json(self) -> dict[str, object] | None:
        if not self.separations:
            return None
        return {
            "rivals": list(self.rivals),
            "why": self.why,
            "separates_from": SEPARATES,
            "experiments": [
                {"experiment": s.experiment, "seconds": s.seconds, "over_floor": dict(s.over_floor)}
                for s in self.separations
            ],
        }


def rivals_of(final: Model, steps: Sequence[Step[Stage]]) -> dict[tuple[str, str], Model]:
    """The final model with an effect of it exchanged for one that these data cannot tell from it.

    By (effect, rival); exact equivalents are left out, as no experiment could ever part them.
    """
    found: dict[tuple[str, str], Model] = {}
    for step in steps:
        if step.effect not in final.effects:
            continue
        for name, model in step.rival_models.items():
            exact = name in effect(step.effect).equivalents or step.effect in effect(name).equivalents
            if exact or name in final.effects or len(found) == MOST_RIVALS:
                continue
            found[step.effect, name] = final.without([step.effect]).with_effect(name, model.of(name))
    return found


def _record(offer: Offer, like: Record) -> Record:
    """The offer as a record, sensed as ``like`` was; what would be measured is not known yet."""
    delay = float(like.excitation.act_times_s[0] - like.excitation.times_s[0])
    return make_record(
        offer.name,
        offer.times_s,
        offer.duty_pct,
        np.zeros(len(offer.times_s)),
        mode=offer.modes,
        kind=like.kind,
        unit=like.unit,
        quantum=like.quantum,
        command_delay_s=delay,
        rotary=like.rotary,
        at_rest=True,
        clock_s=like.excitation.clock_s + like.seconds,
    )


def _moved(model: Model, names: Sequence[str], step: np.ndarray) -> Model:
    values: dict[str, Value] = {}
    for name, change in zip(names, step, strict=True):
        parameter = model.parameter(name)
        values[name] = float(np.clip(model.number(name) + change, parameter.lower, parameter.upper))
    return model.with_values(values)


def _normal(fitted: Fit) -> np.ndarray:
    return np.asarray(sum(c.T @ c for c in fitted.jacobians))


def fitted_again(rival: Fit, old: np.ndarray, record: Record, start: Start) -> Model:
    """The rival as a fit to the old data and to ``record`` would leave it: one step, shortened while it does not pay.

    ``old`` (k, k) is the normal matrix of its fit to the old data, which hold it where it is.
    """
    here = fit(rival.model, [record], starts=[start], max_iterations=1, tolerance=NOT_A_STEP)
    if not here.names:
        return rival.model
    columns, residual = here.jacobians[0], here.residuals[0]
    hessian, gradient = old + columns.T @ columns, columns.T @ residual
    scale = np.sqrt(np.maximum(np.diag(hessian), 1e-300))
    step = np.linalg.pinv(hessian / np.outer(scale, scale), rcond=1e-10) @ (gradient / scale) / scale

    def left(model: Model) -> float:
        difference = record.y - free_output(record, Flat.of(model), start)
        return float(np.std(difference))

    moved = [rival.model, *(_moved(rival.model, here.names, share * step) for share in SEARCH.score.step_shares)]
    return min(moved, key=left)


@dataclass(frozen=True)
class Duel:
    """The chosen model against its rivals, each as fitted to ``records``; ``floor`` is that of free run and windows."""

    winner: Model
    rivals: Mapping[str, Fit]
    records: Sequence[Record]
    floor: tuple[float, float]

    def record(self, offer: Offer) -> tuple[Record, Start]:
        """What the winner would give in an experiment, begun where the last log ended."""
        like = self.records[-1]
        start = Start(float(like.y[-1]) if like.kind == ANGLE else 0.0, 0.0)
        record = _record(offer, like)
        return replace(record, y=free_output(record, Flat.of(self.winner), start)), start

    def _over_floor(self, record: Record, model: Model) -> float:
        errors = judge(record, model).errors
        return max(errors.free_run_rms / self.floor[0], errors.window_rms / self.floor[1])

    def predicted(self, offer: Offer) -> Separation:
        """How far every rival would be from the winner, fitted again by one step."""
        record, start = self.record(offer)
        over = {
            name: self._over_floor(record, fitted_again(rival, _normal(rival), record, start))
            for name, rival in self.rivals.items()
        }
        return Separation(offer.name, offer.seconds, over)

    def confirmed(self, offer: Offer) -> Separation:
        """The same after a fit to old and new data that is carried through."""
        record, start = self.record(offer)

        def refit(rival: Fit) -> float:
            starts = [*rival.starts, start]
            found = fit(
                rival.model, [*self.records, record], starts=starts, max_iterations=REFIT_STEPS, tolerance=TOLERANCE
            )
            return self._over_floor(record, found.model)

        return Separation(
            offer.name, offer.seconds, dict(zip(self.rivals, each(refit, list(self.rivals.values())), strict=True))
        )


def separations(duel: Duel, offers: Sequence[Offer]) -> list[Separation]:
    """Every offered experiment; those that promise most are confirmed by whole fits until the best one is."""
    found = {s.experiment: s for s in each(duel.predicted, offers)}
    known = {o.name: o for o in offers}
    confirmed: set[str] = set()
    while len(confirmed) < MOST_CONFIRMED:
        best = _best(list(found.values())).experiment
        if best in confirmed:
            break
        found[best] = duel.confirmed(known[best])
        confirmed.add(best)
    return list(found.values())


def _best(found: Sequence[Separation]) -> Separation:
    """The experiment that separates most rivals, then most clearly, then soonest."""

    def merit(s: Separation) -> tuple[int, float, float]:
        apart = [min(v, DECISIVE) for v in s.over_floor.values() if v >= SEPARATES]
        return len(apart), round(min(apart, default=0.0), 1), -s.seconds

    return max(found, key=merit)


def _words(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names).replace("_", " ")


def _separating(found: Sequence[Separation], chosen: Mapping[str, str], titles: Mapping[str, str]) -> NextExperiment:
    best = _best(found)
    rivals = tuple(chosen)
    apart = [n for n in rivals if best.over_floor[n] >= SEPARATES]
    winners = _words(list(dict.fromkeys(chosen.values())))
    if not apart:
        nearest = max(found, key=lambda s: max(s.over_floor.values()))
        why = (
            f"no experiment of the menu separates {winners} from {_words(rivals)}: the best, {nearest.experiment}, "
            f"differs by {max(nearest.over_floor.values()):.2g} times the floor once all is fitted again"
        )
        return NextExperiment(why, None, rivals, tuple(found))
    least = min(best.over_floor[n] for n in apart)
    why = (
        f"{titles[best.experiment]} ({best.seconds:.0f} s): there {winners} and {_words(apart)} would differ by "
        f"{'at least ' if len(apart) > 1 else ''}{least:.2g} times the floor, once all is fitted again"
    )
    rest = [n for n in rivals if n not in apart]
    if rest:
        why += f"; it does not separate {_words(rest)}"
    return NextExperiment(why, best.experiment, rivals, tuple(found))


def _showing(verdict: str, seen: Exercised, follows: str | None, titles: Mapping[str, str]) -> NextExperiment | None:
    """The experiment for what the data lack; where something is unexplained, for what the residual ``follows``."""
    lacking = [x for x in lacks(seen) if x.experiment in titles and (x.core or verdict == "unexplained")]
    by_need = [
        NextExperiment(f"the logs have hardly any {x.what}: {titles[x.experiment]}", x.experiment) for x in lacking
    ]
    if verdict != "unexplained" or (lacking and lacking[0].core):
        return by_need[0] if by_need else None
    name = SHOWS.get(follows or "")
    if name is not None and name in titles:
        return NextExperiment(f"what remains follows the {str(follows).replace('_', ' ')}: {titles[name]}", name)
    if by_need:
        return by_need[0]
    why = "what remains follows nothing that was looked at"
    return NextExperiment(f"{why}: {titles[OTHERWISE]}", OTHERWISE) if OTHERWISE in titles else None


def propose(
    verdict: str,
    final: Stage,
    steps: Sequence[Step[Stage]],
    train: Sequence[Record],
    seen: Exercised,
    follows: str | None,
    offers: Sequence[Offer],
    say: Callable[[str], None] = lambda text: None,
) -> NextExperiment | None:
    """The next experiment of the menu, or None where none is called for; ``follows`` is what the residual follows."""
    if not offers:
        return None
    titles = {o.name: o.title for o in offers}
    exchanged = rivals_of(final.fit.model, steps)
    if exchanged:
        say(f"looking for an experiment that separates {len(exchanged)} rivals")
        records, _ = folds(train)
        windows = final.fit.windows
        fits = each(
            lambda m: fit(m, records, windows=windows, max_iterations=REFIT_STEPS, tolerance=TOLERANCE),
            list(exchanged.values()),
        )
        errors, floors = pool([j.errors for j in final.judgements]), pool([f.errors for f in final.floors])
        if errors and floors:
            floor = (max(errors.free_run_rms, floors.free_run_rms), max(errors.window_rms, floors.window_rms))
            rivals = {rival: f for (_, rival), f in zip(exchanged, fits, strict=True)}
            found = separations(Duel(final.fit.model, rivals, records, floor), offers)
            apart = _separating(found, {rival: name for name, rival in exchanged}, titles)
            if apart.experiment is not None or verdict != "unexplained":
                return apart
    return _showing(verdict, seen, follows, titles)
