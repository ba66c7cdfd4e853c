"""Fits that are not believed, whatever they explain: at bounds, without width, below their floor, or no better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from fiohost.discover.candidate import Candidate
from fiohost.discover.step import Found
from fiohost.estimation.fit import Fit
from fiohost.estimation.intervals import Estimate, estimates
from fiohost.judging.floor import Floor
from fiohost.judging.metrics import Errors, pool
from fiohost.judging.stage import Stage
from fiohost.motor.effect import effect
from fiohost.motor.model import Model

CORE = "linear"


@dataclass(frozen=True)
class DegenerateSettings:
    """By what a fit shows that it is none."""

    # A 95 % interval this many times as wide as its value says nothing of it.
    widest: float = 1.0
    # Where even those of the model's own data that err least err so many times more than the data that it was fitted
    # to, these are not such. Others may err by any size: in some a shaft sticks that did not.
    floor_above: float = 2.0
    # Errors this close, as a factor, are as they were.
    as_it_was: float = 1.0
    # Of an effect that is there so many bootstrap samples come to nil at most: those beyond one end of a 95 % interval.
    beyond: float = 0.025
    # Where what remains is no noise, deviance promises too much, and small remains have many takers: there an effect
    # takes this share of the squared error of windows that was left before it.
    least_of_rest: float = 0.3


SETTINGS = DegenerateSettings()


def core_lost(found: Fit, scattered: Sequence[Model] = (), settings: DegenerateSettings = SETTINGS) -> str | None:
    """Why a fit says nothing of the motor itself, or None: what was added may do what a part of it does.

    ``scattered`` are models fitted to bootstrap samples.
    """
    for name, value in estimates(found, scattered).items():
        if not name.startswith(f"{CORE}.") or name not in found.names:
            continue
        if value.at_bound:
            return f"with it {name} goes to its bound {value.value:g} {value.unit}"
        if _width(value) > settings.widest * abs(value.value):
            return f"with it {name} is anywhere in {value.ci95[0]:.3g}..{value.ci95[1]:.3g} {value.unit}"
    return None


def degenerate(before: Stage, after: Stage, taken: float = 0.0, settings: DegenerateSettings = SETTINGS) -> str | None:
    """Why a fit with effects added is not believed, or None; of the squared error of windows it has ``taken`` a share:
    whole runs that differ from each other need not come closer to their mean.
    """
    if lost := core_lost(after.fit, after.scattered_models, settings):
        return lost
    was, now = pool([j.errors for j in before.judgements]), pool([j.errors for j in after.judgements])
    least = pool([_least(f) for f in after.floors])
    if was is None or now is None or least is None:
        return None
    if least.window_rms > settings.floor_above * now.window_rms and least.free_run_rms > now.free_run_rms:
        return f"with it the model's own data err by {least.window_rms:.3g} at least, these by {now.window_rms:.3g}"
    closest = min(now.window_rms / was.window_rms, now.free_run_rms / was.free_run_rms)
    if closest >= settings.as_it_was and taken <= 0.0:
        return "with it the error is no lower than before"
    return None


def _least(floor: Floor) -> Errors:
    """The errors of a record's replicas that err least."""
    draws = [d.errors for d in floor.draws]
    window, free = min(d.window_rms for d in draws), min(d.free_run_rms for d in draws)
    return replace(floor.errors, window_rms=window, free_run_rms=free)


def may_vanish(after: Stage, name: str, settings: DegenerateSettings = SETTINGS) -> str | None:
    """Why an effect may as well not be there, or None: of each of its sizes the 95 % interval holds the value where it
    vanishes, or of bootstrap samples one in forty comes to that (percentiles, Efron 1979). Those few in which a shaft
    sticks may be far off: they make a standard deviation say nothing.
    """
    if name not in after.fit.model.effects:
        return None
    known, wide, whys = estimates(after.fit), estimates(after.fit, after.scattered_models), []
    for size in (p for p in effect(name).parameters if p.neutral is not None and p.is_smooth and not p.ragged):
        key, neutral = f"{name}.{size.name}", float(size.neutral or 0.0)
        low, high = known[key].ci95
        beyond = [(m.number(key) - neutral) * (known[key].value - neutral) <= 0.0 for m in after.scattered_models]
        if not low <= neutral <= high and sum(beyond) <= settings.beyond * len(beyond):
            return None
        low, high = wide[key].ci95
        whys.append(f"its {size.name} is anywhere in {low:.3g}..{high:.3g} {size.unit}")
    return whys[0] if whys else None


def _little(before: Stage, after: Stage, settings: DegenerateSettings = SETTINGS) -> str | None:
    """Why an effect beside which something else is missing is not believed, or None."""
    was, now = pool([j.errors for j in before.judgements]), pool([j.errors for j in after.judgements])
    if was is None or now is None:
        return None
    share = 1.0 - (now.window_rms / was.window_rms) ** 2
    if share >= settings.least_of_rest:
        return None
    return f"removes {100 * max(share, 0.0):.0f} % of what was left in windows, and what remains is no noise"


def _width(value: Estimate) -> float:
    return value.ci95[1] - value.ci95[0]


def believed(found: Found[Stage], hidden: Mapping[str, str]) -> Found[Stage]:
    """The outcome of a search as far as its fits are believed: without what was added last where it is degenerate, or
    leaves something with an effect that the logs cannot show; ``hidden`` says why they cannot.
    """
    while found.steps:
        why = degenerate(found.stages[0], found.final, found.taken)
        unseen = [hidden[s.effect] for s in found.steps if s.effect in hidden]
        if why is None and unseen and not found.final.follows:
            why = f"these logs cannot show it: {unseen[0]}"
        last, kept = found.steps[-1], found.steps[:-1]
        if found.noise is not None or not found.final.follows:
            # Whole runs that are followed to the count say more than an interval: two sizes may be known together only.
            why = why or may_vanish(found.final, last.effect)
        if why is None and found.noise is not None and not found.white:
            why = _little(kept[-1].stage if kept else found.stages[0], found.final)
        if why is None:
            break
        back = Candidate(last.effect, float(str(last.evidence["residual_power_removed"])), why)
        offered = [back, *(c for c in found.offered if c.effect != last.effect)]
        stages = (found.stages[0], kept[-1].stage) if kept else found.stages[:1]
        found = Found(stages, kept, tuple(offered), found.one_clock, found.noise, False)
    return found
