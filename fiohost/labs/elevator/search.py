"""A controller that meets the text's criteria both ways, looked for on the model."""

from __future__ import annotations

from itertools import product

import numpy as np

from fiohost.control.closed_loop import Plant, run_loop
from fiohost.labs.elevator.car import (
    DEG_PER_CM,
    MOST_ERROR_CM,
    MOST_OVERSHOOT_PCT,
    MOST_SETTLING_S,
    MOTOR,
    Design,
    Move,
    Record,
    moves,
)
from fiohost.labs.elevator.ride import STAY_S, WAIT_S, up_and_down
from fiohost.motor.model import Model

GAINS = (1.5, 2.0, 3.0, 4.0, 5.0)
INTEGRAL_GAINS = (0.0, 0.1, 0.3)
POWERS_PCT = (40.0, 60.0, 80.0, 100.0)
DERIVATIVE_GAINS = (0.0, 0.05, 0.1, 0.2, 0.3)
MARGIN = 0.9  # of each criterion: a target is not its model


def simulate(model: Model, design: Design, tick_s: float, quantum_deg: float) -> Record:
    """Up one floor and back on the model, commands acting one tick late as on a bench."""
    times = np.arange(round((WAIT_S + 2.0 * STAY_S) / tick_s)) * tick_s
    ref_cm = np.array([up_and_down(t) or 0.0 for t in times])
    loop = design.settings(MOTOR.supply_V).loop(tick_s, tick_s, quantum_deg)
    run = run_loop(Plant.of(model), loop, DEG_PER_CM * ref_cm)
    return Record(run.time_s, ref_cm, run.angle_deg / DEG_PER_CM, run.duty_pct)


def best_design(model: Model, tick_s: float, quantum_deg: float) -> Design | None:
    """The design that settles fastest, both ways, among those that meet every criterion with a tenth to spare."""
    best: tuple[float, Design] | None = None
    for values in product(GAINS, INTEGRAL_GAINS, POWERS_PCT, DERIVATIVE_GAINS):
        design = Design(*values)
        made = list(moves(simulate(model, design, tick_s, quantum_deg)))
        slowest = max(move.figures.settling_5_s for move in made)
        if all(_well_within(move) for move in made) and (best is None or slowest < best[0]):
            best = (slowest, design)
    return best[1] if best else None


def _well_within(move: Move) -> bool:
    f = move.figures
    return (
        f.overshoot_pct <= MARGIN * MOST_OVERSHOOT_PCT
        and abs(f.steady_state_error) <= MARGIN * MOST_ERROR_CM
        and f.settling_5_s <= MARGIN * MOST_SETTLING_S
    )
