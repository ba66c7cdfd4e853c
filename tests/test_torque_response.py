"""What a random torque does to the output, as noise is weighed by it, against the kernel: with each effect."""

from __future__ import annotations

import random

import numpy as np
import pytest
from pairs import NAMES, as_model, draw_plant

from fiohost.discover.logs.movement import movement
from fiohost.discover.logs.whitened import motor_of
from fiohost.estimation.fit import fit
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import ANGLE, make_record
from fiohost.motor.simulate import Start, run_loaded, seen_angle, start_state
from fiohost.noise.covariance import Movement, response

STEP_S, SECONDS, PUSH_PCT = 0.005, 20.0, 0.05
PUSHED, SEEN = 10, 60
# A shaft may catch and let go of a gap, a bridge may run empty: most moments are asked, not all.
MOST, NEAR = 0.8, 0.1


@pytest.mark.parametrize("name", NAMES)
def test_a_small_push_moves_the_shaft_as_its_covariance_says(name: str) -> None:
    """50 ms of it, 0.3 s later. Of a winding it was four times as much, of a load on a spring two thirds."""
    rng, n = np.random.default_rng(1), round(SECONDS / STEP_S)
    model = as_model(draw_plant(random.Random(f"push {name}"), (name,)))
    times, duty = np.arange(n) * STEP_S, np.repeat(rng.uniform(-80.0, 80.0, 80), rng.integers(50, 150, 80))[:n]
    flat = Flat.of(model)
    bare = make_record("bare", times, duty, np.zeros(n), quantum=0.5, at_rest=True)
    angle = free_output(bare, flat, Start(0.0, 0.0))
    record = make_record("run", times, duty, angle, quantum=0.5, at_rest=True)
    (start,) = fit(model, [record], windows=True, max_iterations=1, tolerance=1e30).starts
    moves, motor, seen = movement(record, model, start), motor_of(record, model), seen_angle(flat.p, flat.on)

    def pushed(load: np.ndarray) -> np.ndarray:
        begin = start_state(Start(0.0, 0.0), flat.p, flat.on)
        return run_loaded(record.excitation, flat.p, flat.on, flat.substep_s, begin, load)

    free, shares = pushed(np.zeros(n)), []
    for first in rng.integers(200, n - SEEN - 1, 30).tolist():
        there = slice(first, first + SEEN)
        speed = np.gradient(free[there, seen]) / STEP_S
        if np.abs(speed).min() < 20.0 or np.ptp(np.sign(speed)) > 0.0:
            continue
        load = np.zeros(n)
        load[first : first + PUSHED] = -PUSH_PCT
        moving = Movement(moves.lag_s[there], moves.keeps[there])
        said = (
            response(times[there] - times[first], moving, motor.gain, motor.tau_s, ANGLE)[-1, :PUSHED].sum() * PUSH_PCT
        )
        shares.append((pushed(load)[there, seen][-1] - free[there, seen][-1]) / said)
    assert len(shares) >= 5
    assert np.mean(np.abs(np.array(shares) - 1.0) < NEAR) >= MOST, np.round(shares, 2)
