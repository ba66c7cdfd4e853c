"""Every name asked for again once all the others are there: what was added first was chosen while they were missing."""

from __future__ import annotations

from dataclasses import replace

from fiohost.discover.exchange import better
from fiohost.discover.refit import again, as_it_is
from fiohost.discover.round import Candidate, run_round, winner
from fiohost.discover.search import Search
from fiohost.discover.stage import Stage
from fiohost.discover.step import Found, Step, named_with
from fiohost.estimation.fit import Fit


def reconsidered(search: Search, found: Found) -> Found:
    """What a search came to, each of its names taken out and the library tried in its place, beside all the others.

    What fits as well and is simpler, or fits better, takes the place; what these data cannot tell from it is named
    beside it, instead of what they could not while the others were missing. Only of what follows the data: elsewhere
    the rest of a model is no ground to stand on.
    """
    final, steps = found.final, list(found.steps)
    if len(steps) < 2 or not final.follows or found.one_clock:
        return found
    changed = False
    for i in range(len(steps)):
        if i == len(steps) - 1 and not changed:
            break  # the last was chosen beside all the others
        name = steps[i].effect
        search.context.say(f"{name}, asked for again beside the others")
        outcome = run_round(search.context, replace(final, fit=_rest(search, final, name)), first=False)
        able = [(c, c.validated) for c in outcome.candidates if c.validated is not None and c.effect != name]
        here = search.context.validate(final.fit)
        takers = [(c, v) for c, v in able if better(v.fit, c.effect, final.fit, name)]
        if takers:
            taken, validated = winner(takers)
            stage = search.settled(validated.fit)
            if stage.follows:
                search.context.say(f"{taken.effect} takes the place of {name}")
                steps = _with_another(search, steps, i, taken, stage)
                final, here, changed = stage, validated, True
        rivals = search.rivals(steps[i].effect, here, outcome)
        rivals.pop(name, None)
        named = named_with(steps[i].effect, rivals)
        steps[i] = replace(steps[i], indistinguishable_from=named, rival_models=rivals)
    return replace(found, stages=(*found.stages[:-1], final), steps=tuple(steps))


def _rest(search: Search, stage: Stage, name: str) -> Fit:
    return as_it_is(stage.fit, stage.fit.model.without([name]), search.records)


def _with_another(search: Search, steps: list[Step], at: int, taken: Candidate, final: Stage) -> list[Step]:
    """The steps with another effect in the place of one of them, and every later stage with it."""
    name = steps[at].effect
    values = {k: v for k, v in final.fit.model.values.items() if k.startswith(taken.effect + ".")}
    changed = list(steps)
    for i in range(at, len(steps)):
        was = steps[i].stage.fit
        model = was.model.with_swapped(name, taken.effect, values)
        last = i == len(steps) - 1
        changed[i] = replace(steps[i], stage=final if last else search.stage(again(was, model, search.records)))
    evidence = {**steps[at].evidence, "residual_power_removed": taken.score, "in_place_of": name}
    changed[at] = replace(changed[at], effect=taken.effect, evidence=evidence)
    return changed
