"""The end of each lab of the appendix: runs that say what its model lacks beside its target.

The runs are so small that no limit of the target's current cuts them: at rest a winding has no back-emf, so a step asks
for most there. Three sizes, both ways: friction, a lost voltage and a load differ by speed and direction. Each step is
taken back after half of the run: dry friction slows a shaft that nothing drives, a deadband does not, and at a steady
speed the two are one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fiohost.labs.difference import SMALL
from fiohost.labs.result import LabResult
from fiohost.labs.session import Session, volts
from fiohost.motor.model import Model

REACHES = 0.7  # of the current's limit, by a standing winding
SHARE = 0.5  # of full duty, at most
SHARES = (1.0, -0.6, 0.4)  # of the voltage that reaches so far
DURATION_S = 2.0


def with_small_steps(session: Session, result: LabResult) -> tuple[LabResult, Model, Model | None]:
    """The result with logs of small steps, the session's model, and that model with the limit of the bench's current:
    what ``with_difference`` takes. No steps where nothing but the lab's own law may turn the shaft.
    """
    if session.presses:
        small_steps(session, result.name.replace("-", "_"))
        result = replace(result, files={**session.logs, **result.files})
    q, amperes = session.constants, session.bench_limits.amperes
    return result, q.model(), None if amperes is None else q.model(current_limit_A=amperes)


def small_steps(session: Session, experiment: str) -> None:
    """Steps of voltage in open loop, both ways, on and off."""
    most_V, amperes = SHARE * session.full_V, session.bench_limits.amperes
    if amperes is not None:
        most_V = min(most_V, REACHES * amperes * session.constants.R_ohm)
    for number, share in enumerate(SHARES, start=1):
        session.on_target(f"{experiment}{SMALL}{number}", volts(_on_and_off(share * most_V), DURATION_S), DURATION_S)


def _on_and_off(level_V: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda time_s: np.where(time_s < 0.5 * DURATION_S, level_V, 0.0)
