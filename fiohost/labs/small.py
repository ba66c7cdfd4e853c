"""Runs so small that no limit of the target's current cuts them: the logs that say what a linear model lacks.

At rest a winding has no back-emf, so a step asks for most there. Three sizes, both ways: friction, a lost voltage and
a load differ by speed and direction. None is made where nothing limits the target's current.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fiohost.labs.difference import SMALL
from fiohost.labs.session import Gains, MakeLaw, Session, position, volts

REACHES = 0.7  # of the current's limit
SHARES = (1.0, -0.6, 0.4)  # of the voltage that reaches so far
DURATION_S = 2.0


def small_steps_of_angle(session: Session, gains: Sequence[float], experiment: str) -> None:
    """A step of the reference for each P gain in V/rad, to and fro."""
    for number, kp in enumerate(gains):
        ref_deg = (-1.0) ** number * float(np.degrees(_most_V(session) / kp))
        _run(session, f"{experiment}{SMALL}kp{kp:g}".replace(".", "p"), position(Gains(kp), ref_deg))


def small_steps_of_voltage(session: Session, experiment: str) -> None:
    """Steps of voltage in open loop, both ways."""
    for number, share in enumerate(SHARES, start=1):
        _run(session, f"{experiment}{SMALL}{number}", volts(share * _most_V(session), DURATION_S))


def _run(session: Session, case: str, law: MakeLaw) -> None:
    """Once in a sitting, and only where it is of use."""
    if _most_V(session) and f"log {case}" not in session.logs:
        session.on_target(case, law, DURATION_S)


def _most_V(session: Session) -> float:
    """What a standing winding may get; 0 where nothing limits the target's current."""
    return REACHES * (session.bench_limits.amperes or 0.0) * session.constants.R_ohm
