"""Derivatives of one-second windows along their tangent, beside those with every window fitted anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench_data import QUANTUM_DEG, measure, steps, truth_model

from fiohost.discover.logs.movement import movement
from fiohost.discover.logs.whitened import with_noise
from fiohost.estimation.fit import fit
from fiohost.estimation.predict import Flat, free_output, windowed
from fiohost.estimation.record import Record
from fiohost.estimation.solver import Point, Problem
from fiohost.estimation.starts import first_starts
from fiohost.estimation.tangent import Tangent
from fiohost.motor.effect import Value
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.estimate import NONE, Ranged

EFFECTS: dict[str, dict[str, Value]] = {
    "quadratic_drag": {"quadratic_drag.pct_at_1000_deg_s": 30.0},
    "armature_inductance": {"armature_inductance.time_constant_s": 0.006},
    "armature_heating": {"armature_heating.rise_ratio": 0.3, "armature_heating.time_constant_s": 8.0},
    "gravity_load": {"gravity_load.level_pct": 4.0, "gravity_load.phase_deg": 30.0},
    "encoder_eccentricity": {"encoder_eccentricity.level_deg": 2.0, "encoder_eccentricity.phase_deg": 50.0},
    "transport_delay": {"transport_delay.delay_s": 0.004},
}


def _finely(truth: Model, seed: int) -> Record:
    """Steps that never let the shaft rest, read without counts."""
    rng = np.random.default_rng(seed)
    duty = np.where(steps(12.0, rng) > 0.0, 1.0, -1.0) * rng.uniform(30.0, 60.0)
    record = replace(measure(truth, duty, rng), quantum=0.0)
    return replace(record, y=free_output(record, Flat.of(truth), Start(0.0, 0.0)), weights=np.ones(len(record)))


@pytest.mark.parametrize("name", EFFECTS)
def test_where_a_model_fits_the_tangent_is_the_derivative(name: str) -> None:
    truth = truth_model((name,), EFFECTS[name])
    records = [_finely(truth, 3)]
    problem = Problem(truth, records, True)
    point = Point(truth.vector(), first_starts(problem.base, records))
    residuals, _ = problem.residuals(point)
    along, anew = (problem.linearise(point, residuals, exactly) for exactly in (False, True))
    for a, b in zip((*along[0], *along[1]), (*anew[0], *anew[1]), strict=True):
        for i in range(a.shape[1]):
            assert np.linalg.norm(a[:, i] - b[:, i]) < 0.05 * np.linalg.norm(b[:, i]), i


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("weighed", [False, True])
def test_the_tangent_is_the_derivative_where_windows_begin_at_rest_and_turn_under_any_weights(
    seed: int, weighed: bool
) -> None:
    rng = np.random.default_rng(seed)
    truth = truth_model(("coulomb_friction",), {"coulomb_friction.level_pct": 4.5})
    record = measure(truth, _with_rests(rng), rng)
    begin = Start(0.0, 0.0)
    if weighed:
        noise = replace(NONE, torque_pct=Ranged(1.0, 1.0, 1.0), torque_s=Ranged(0.1, 0.1, 0.1))
        (record,) = with_noise([record], truth, noise, [movement(record, truth, begin)])
    problem = Problem(truth, [record], True)
    point = Point(truth.vector(), [begin])
    residuals, _ = problem.residuals(point)
    (along,), (anew,) = (problem.linearise(point, residuals, exactly)[0] for exactly in (False, True))
    for i, name in enumerate(problem.names):
        assert np.linalg.norm(along[:, i] - anew[:, i]) < 0.2 * np.linalg.norm(anew[:, i]), name


def _with_rests(rng: np.random.Generator) -> np.ndarray:
    """Twelve seconds of steps to either side, rests between them."""
    levels = np.where(np.arange(24) % 3 == 0, 0.0, rng.uniform(8.0, 40.0, 24) * rng.choice([-1.0, 1.0], 24))
    return np.repeat(levels, 100)


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_along_the_tangent_ends_where_the_exact_one_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = {"coulomb_friction.level_pct": rng.uniform(1.0, 5.0), "constant_load.level_pct": rng.uniform(-3.0, 3.0)}
    truth = truth_model(("coulomb_friction", "constant_load"), values)
    records = [measure(truth, steps(15.0, rng), rng) for _ in range(2)]
    guess = {"linear.gain_deg_s_per_pct": 8.0, "linear.tau_s": 0.05, "coulomb_friction.level_pct": 2.0}
    begin = truth.with_values(guess)
    near = fit(begin, records, windows=True, tolerance=1e-4)
    exact = fit(begin, records, windows=True, tolerance=1e-7)
    assert near.rms == pytest.approx(exact.rms, rel=0.01)
    assert exact.rms < QUANTUM_DEG / 3.0


@pytest.mark.parametrize("name", ["quadratic_drag", "armature_heating", "gravity_load"])
def test_where_few_windows_are_looked_at_derivatives_are_theirs_and_work_is_on_no_other(name: str) -> None:
    rng = np.random.default_rng(4)
    truth = truth_model((name,), EFFECTS[name])
    record, start = measure(truth, steps(40.0, rng), rng), Start(0.2, 0.0)
    flat, other = Flat.of(truth), Flat.of(truth.with_values({"linear.tau_s": 0.08}))
    few = replace(record, every=5)
    firsts, lasts = few.looked_at
    looked = np.concatenate([np.arange(a, b) for a, b in zip(firsts, lasts, strict=True)])
    whole, part = (Tangent(r, flat, start, windowed(r, flat, start)[1]) for r in (record, few))
    assert len(part.by(other, start, 0.01)) == len(looked) < 0.3 * len(record)
    expected = whole.by(other, start, 0.01)[looked]
    # States that are not kept are simulated again from a window's beginning: the same but for rounding.
    np.testing.assert_allclose(part.by(other, start, 0.01), expected, rtol=0.0, atol=1e-6 * np.abs(expected).max())
