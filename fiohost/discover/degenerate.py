"""Fits that are not believed, whatever they explain: at bounds, without width, below their floor, or no better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fiohost.discover.candidate import Candidate
from fiohost.discover.metrics import pool
from fiohost.discover.stage import Stage
from fiohost.discover.step import Found
from fiohost.estimation.intervals import Estimate, estimates

CORE = "linear"


@dataclass(frozen=True)
class DegenerateSettings:
    """By what a fit shows that it is none."""

    # A 95 % interval this many times as wide as its value says nothing of it.
    widest: float = 1.0
    # Data of the model's own that err so many times more than those that it was fitted to show that these are not such.
    floor_above: float = 2.0
    # Errors this close, as a factor, are as they were.
    as_it_was: float = 1.0


SETTINGS = DegenerateSettings()


def degenerate(before: Stage, after: Stage, settings: DegenerateSettings = SETTINGS) -> str | None:
    """Why a fit with effects added is not believed, or None."""
    known = estimates(after.fit, after.scattered_models)
    for name, value in known.items():
        if not name.startswith(f"{CORE}.") or name not in after.fit.names:
            continue
        if value.at_bound:
            return f"with it {name} goes to its bound {value.value:g} {value.unit}"
        if _width(value) > settings.widest * abs(value.value):
            return f"with it {name} is anywhere in {value.ci95[0]:.3g}..{value.ci95[1]:.3g} {value.unit}"
    was, now = pool([j.errors for j in before.judgements]), pool([j.errors for j in after.judgements])
    floor = pool([f.errors for f in after.floors])
    if was is None or now is None or floor is None:
        return None
    if floor.window_rms > settings.floor_above * now.window_rms and floor.free_run_rms > now.free_run_rms:
        return f"with it the model's own data err by {floor.window_rms:.3g}, these by {now.window_rms:.3g} only"
    if min(now.window_rms / was.window_rms, now.free_run_rms / was.free_run_rms) >= settings.as_it_was:
        return "with it the error is no lower than before"
    return None


def _width(value: Estimate) -> float:
    return value.ci95[1] - value.ci95[0]


def believed(found: Found, hidden: Mapping[str, str]) -> Found:
    """The outcome of a search, or that of the declared model alone where its fit with effects is degenerate, or leaves
    something with an effect that the logs cannot show; ``hidden`` says why they cannot.
    """
    if not found.steps:
        return found
    why = degenerate(found.stages[0], found.final)
    unseen = [hidden[s.effect] for s in found.steps if s.effect in hidden]
    if why is None and unseen and not found.final.follows:
        why = f"these logs cannot show it: {unseen[0]}"
    if why is None:
        return found
    back = _taken_back(found, why)
    return Found(found.stages[:1], (), tuple(back), found.one_clock, found.noise, False)


def _taken_back(found: Found, why: str) -> Sequence[Candidate]:
    names = [s.effect for s in found.steps]
    taken = [Candidate(s.effect, float(str(s.evidence["residual_power_removed"])), why) for s in found.steps]
    return [*taken, *(c for c in found.offered if c.effect not in names)]
