"""One effect in the place of another: what was mistaken for a part of one that was added later gives way."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.choose import Validated, objection
from fiohost.discover.refit import again
from fiohost.discover.round import AS_GOOD_FITTED, Candidate, Context
from fiohost.discover.stage import Stage
from fiohost.discover.step import Step, named_with
from fiohost.estimation.fit import Fit
from fiohost.motor.effect import effect, effects
from fiohost.motor.model import Model

# So many that could have been added instead are tried again in the place of the winner once another effect is there.
MOST_OTHERS = 3
# Where whole runs can never be followed, what explains this share of what the winner does may as well be the cause.
ALIKE = 0.5


def swapped(
    context: Context, fitted: Fit, steps: Sequence[Step], stage_of: Callable[[Fit], Stage]
) -> tuple[Fit, list[Step]]:
    """Put in the place of every earlier effect what could have been added then, where that fits as well and is
    simpler, or fits better: what a later effect explains was mistaken for a part of it.
    """
    kept = list(steps)
    for i, step in enumerate(steps):
        if step.effect not in fitted.model.effects:
            continue
        for other in step.others[:MOST_OTHERS]:
            if other.validated is None or other.effect in fitted.model.effects:
                continue
            values = {k: v for k, v in other.validated.fit.model.values.items() if k.startswith(other.effect + ".")}
            model = fitted.model.with_swapped(step.effect, other.effect, values)
            rival = again(fitted, model, context.records)
            if not better(rival, other.effect, fitted, step.effect):
                continue
            context.say(f"{other.effect} takes the place of {step.effect}")
            fitted = rival
            kept[i] = _taken_by(step, other, other.validated, stage_of)
            break
    return fitted, kept


def _taken_by(step: Step, other: Candidate, validated: Validated, stage_of: Callable[[Fit], Stage]) -> Step:
    """A step with another effect in the place of the one that was added."""
    evidence = {
        **step.evidence,
        "residual_power_removed": other.score,
        "cross_validated_error_ratio": float(np.sqrt(validated.cost / step.base_cost)),
        "in_place_of": step.effect,
    }
    return Step(other.effect, stage_of(validated.fit), evidence, named_with(other.effect, {}))


def commonest(step: Step, stage_of: Callable[[Fit], Stage]) -> Step:
    """The step with the simplest and commonest of the effects that explain not much less, all of them named with it.

    More is missing than any of them explains, so that which of them comes closest is chance.
    """
    gain = 1.0 - float(str(step.evidence["cross_validated_error_ratio"])) ** 2
    alike = {
        c.effect: (c, c.validated)
        for c in step.others
        if c.validated is not None and 1.0 - c.validated.cost / step.base_cost >= ALIKE * gain
    }
    models = {step.effect: step.stage.fit.model, **{name: v.fit.model for name, (_, v) in alike.items()}}
    first = min(models, key=lambda name: (len(effect(name).parameters), effect(name).commonness))
    taken = step if first == step.effect else _taken_by(step, *alike[first], stage_of)
    rivals = {name: model for name, model in models.items() if name != first}
    return replace(taken, indistinguishable_from=named_with(first, rivals), rival_models=rivals)


def exchanged(context: Context, fitted: Fit, declared: Model) -> tuple[Fit, dict[str, str]]:
    """Put in the place of an added effect its equivalent where that fits clearly better, and which by which.

    What is equivalent by itself is not so beside another effect: a load stays as friction warms up.
    """
    told: dict[str, str] = {}
    added = [e for e in fitted.model.effects if e not in declared.effects]
    for name in added if len(added) > 1 else []:
        for other in effect(name).equivalents:
            if other in fitted.model.effects or other not in (context.library or effects()):
                continue
            rival = again(fitted, in_place_of(fitted.model, name, other), context.records)
            if fitted.cost > AS_GOOD_FITTED * rival.cost and objection(rival, other) is None:
                context.say(f"{other} takes the place of {name}")
                fitted, told[name] = rival, other
                break
    return fitted, told


def in_place_of(model: Model, name: str, other: str) -> Model:
    """A model with another effect in the place of one, begun from the level of what it also replaces."""
    levels = [model.number(f"{r}.level_pct") for r in effect(other).replaces if r in model.effects]
    values = {p.name: levels[0] for p in effect(other).parameters} if levels else {}
    return model.without([name]).with_effect(other, values)


def better(rival: Fit, rival_name: str, fitted: Fit, name: str) -> bool:
    """Whether a fit with another effect is to be preferred: clearly closer, or as close and simpler or commoner."""
    if rival.cost > AS_GOOD_FITTED * fitted.cost or objection(rival, rival.model.effects[-1]):
        return False
    if fitted.cost > AS_GOOD_FITTED * rival.cost:
        return True
    ranks = [(len(effect(n).parameters), effect(n).commonness) for n in (rival_name, name)]
    return ranks[0] < ranks[1]
