"""What the model of a lab lacks beside its target, named by the diagnosis from the lab's own logs.

The end of each lab: simulation and bench stood side by side, they differed, and the circle that serves any log says
by what. A few logs, the effects that such a lab can show and a model without limits keep it short; the whole of it is
``fiohost diagnose``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from fiohost.errors import FiohostError
from fiohost.labs.result import Answer, LabResult
from fiohost.motor.model import Model

MOST_LOGS, MOST_ROWS = 3, 2000  # short logs say as much in a fraction of the time
FREE = ("linear.gain_deg_s_per_pct", "linear.tau_s", "constant_load.level_pct")  # limits and winding are known
LOOKED_FOR = ("coulomb_friction", "input_deadband", "backlash")
LEFT_OUT = ("disturbed", "pressed", "pi_", "ride")  # a hand on the shaft, and what repeats another log
QUESTION = "What does the model lack that the target has?"


def logs_of(result: LabResult) -> list[str]:
    """The logs that are looked at: first, middle and last of the short ones that hold nothing but motor and law."""
    found = [
        name
        for role, name in result.files.items()
        if role.startswith("log") and name.endswith(".csv") and not any(word in Path(name).name for word in LEFT_OUT)
    ]
    short = [name for name in found if Path(name).read_bytes().count(b"\n") <= MOST_ROWS]
    return short if len(short) <= MOST_LOGS else [short[0], short[len(short) // 2], short[-1]]


def with_difference(result: LabResult, model: Model, say: Callable[[str], None] = lambda text: None) -> LabResult:
    """The result with what the diagnosis says of its logs; where it cannot say anything, with the reason."""
    from fiohost.circle.evidence import diagnose
    from fiohost.discover.result import to_json
    from fiohost.report.words import verdict_sentence

    logs = logs_of(result)
    if not logs:
        return result
    model = replace(model, fixed=frozenset(set(model.values) - set(FREE)))
    say(f"what the model lacks, from {', '.join(Path(name).name for name in logs)}")
    try:
        found: Mapping[str, Any] = to_json(diagnose(logs, model=model, library=LOOKED_FOR))
    except FiohostError as exc:
        return replace(result, answers=(*result.answers, Answer(QUESTION, f"These logs do not say: {exc}")))
    told = f"{verdict_sentence(found)} From {' and '.join(Path(name).name for name in logs)}; looked for were "
    told += (
        ", ".join(name.replace("_", " ") for name in LOOKED_FOR)
        + f"; a limit of the current is not in the model. More: fiohost diagnose {' '.join(logs)}"
    )
    values = {
        "verdict": found["verdict"],
        "effects": [step["effect"] for step in found["steps"]],
        "indistinguishable_from": [step.get("indistinguishable_from") or [] for step in found["steps"]],
        "logs": logs,
    }
    return replace(
        result, answers=(*result.answers, Answer(QUESTION, told)), values={**result.values, "difference": values}
    )
