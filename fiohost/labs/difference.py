"""What the model of a lab lacks beside its target, named by the diagnosis from the lab's own logs.

The end of each lab: simulation and bench stood side by side, they differed, and the circle that serves any log says
by what. A few logs and the effects that such a lab can show keep it short; the whole of it is ``fiohost diagnose``. A
limit of the current takes its time to simulate and is left out, so logs that it does not reach are looked at where
there are enough: from two levels of one speed each, a load and another gain would pass for friction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fiohost.bench.log import Log
from fiohost.errors import FiohostError
from fiohost.labs.result import Answer, LabResult
from fiohost.motor.model import Model

MOST_LOGS, MOST_ROWS = 3, 2000  # short logs say as much in a fraction of the time
FREE = ("linear.gain_deg_s_per_pct", "linear.tau_s", "constant_load.level_pct")  # limits and winding are known
LOOKED_FOR = ("coulomb_friction", "input_deadband", "backlash")
SPEED_S, NEAR = 0.02, 0.95  # a speed is taken over so long; so near to its limit a current may be cut
LEFT_OUT = ("disturbed", "pressed", "pi_", "ride")  # a hand on the shaft, and what repeats another log
SMALL = "_small_"  # in the name of a log whose command is so small that no limit is reached
QUESTION = "What does the model lack that the target has?"


def logs_of(result: LabResult, limited: Model | None = None) -> list[str]:
    """The logs that are looked at: first, middle and last of the short ones that hold nothing but motor and law; of
    those where a limit of the current is not reached, if there is such a limit and enough are free of it.
    """
    found = [
        name
        for role, name in result.files.items()
        if role.startswith("log") and name.endswith(".csv") and not any(word in Path(name).name for word in LEFT_OUT)
    ]
    short = [name for name in found if Path(name).read_bytes().count(b"\n") <= MOST_ROWS]
    small = [name for name in short if SMALL in Path(name).name]
    if len(small) >= MOST_LOGS:
        short = small  # made for this question
    if limited is not None:
        free = [name for name in short if not reaches_limit(Log.read(name), limited)]
        short = free if len(free) >= MOST_LOGS else short
    return short if len(short) <= MOST_LOGS else [short[0], short[len(short) // 2], short[-1]]


def reaches_limit(log: Log, model: Model) -> bool:
    """Whether the current limit of a model is reached in a log: by the duty and the speed that was measured."""
    step = max(1, round(SPEED_S / log.sample_time_s))
    if len(log) <= step:
        return False
    turned = np.concatenate((np.zeros(step), (log.output[step:] - log.output[:-step]) / (step * log.sample_time_s)))
    back_pct = turned / model.number("linear.gain_deg_s_per_pct")
    return bool(np.max(np.abs(log.duty_pct - back_pct)) > NEAR * model.number("current_limit.limit_pct"))


def with_difference(
    result: LabResult, model: Model, say: Callable[[str], None] = lambda text: None, *, limited: Model | None = None
) -> LabResult:
    """The result with what the diagnosis says of its logs; where it cannot say anything, with the reason.

    *limited* is the model with the bench's limit of the current, where it has one.
    """
    from fiohost.circle.evidence import diagnose
    from fiohost.discover.result import to_json
    from fiohost.report.words import verdict_sentence

    logs = logs_of(result, limited)
    if not logs:
        return result
    is_limited = limited is not None and any(reaches_limit(Log.read(name), limited) for name in logs)
    model = replace(model, fixed=frozenset(set(model.values) - set(FREE)))
    say(f"what the model lacks, from {', '.join(Path(name).name for name in logs)}")
    try:
        found: Mapping[str, Any] = to_json(diagnose(logs, model=model, library=LOOKED_FOR))
    except FiohostError as exc:
        return replace(result, answers=(*result.answers, Answer(QUESTION, f"These logs do not say: {exc}")))
    told = f"{verdict_sentence(found)}{_sizes(found)} From {' and '.join(Path(name).name for name in logs)}; "
    told += "looked for were "
    told += (
        ", ".join(name.replace("_", " ") for name in LOOKED_FOR)
        + ("; a limit of the current, which some of them reach, is not in the model" if is_limited else "")
        + f". More: fiohost diagnose {' '.join(logs)}"
    )
    values = {
        "verdict": found["verdict"],
        "effects": [step["effect"] for step in found["steps"]],
        "indistinguishable_from": [step.get("indistinguishable_from") or [] for step in found["steps"]],
        "sizes": {key: p["value"] for key, p in _found(found).items()},
        "logs": logs,
    }
    return replace(
        result, answers=(*result.answers, Answer(QUESTION, told)), values={**result.values, "difference": values}
    )


def _found(told: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters of the effects that were found, by ``effect.parameter``."""
    found = {step["effect"] for step in told["steps"]}
    return {key: p for key, p in told["final"]["parameters"].items() if key.partition(".")[0] in found}


def _sizes(told: Mapping[str, Any]) -> str:
    """How large each effect is that was found, with its 95 % interval; empty where none was."""
    from fiohost.report.words import effect_words

    sizes = [f"{effect_words(key.partition('.')[0])} {_sized(p)}" for key, p in _found(told).items()]
    return f" Sizes: {'; '.join(sizes)}." if sizes else ""


def _sized(parameter: Mapping[str, Any]) -> str:
    low, high = parameter.get("ci95") or (None, None)
    told = f"{parameter['value']:.3g} {parameter['unit']}"
    return told if low is None or high is None else f"{told} ({low:.3g} to {high:.3g})"
